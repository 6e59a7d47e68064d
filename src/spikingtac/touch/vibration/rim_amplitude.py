"""The amplitude of a vibration from the events that each place along the markers' edges gives.

Farther from an edge only larger amplitudes are seen; nearer to it, larger amplitudes give more
events. The expected counts (:mod:`spikingtac.touch.vibration.edge_counts`) are fitted to the
counted ones by least squares. What a calibration does not know of the camera, its lag and
its dead time, is fitted along from broad beliefs: fast edges leave fewer events and shift them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from spikingtac.touch.vibration.edge_counts import Edge, edge_counts
from spikingtac.touch.vibration.rim_cells import RING_PX, RINGS, ring_distances_px

Field = NDArray[np.float64]

COUNT_ERROR = 0.3
"""Error of the expected events of a cell, per cycle (ours: discs are no circles, and lie 0.1 px
away from where they are expected; twice what the fits leave)."""
LOG_LAG, LOG_DEAD, LOG_WIDTH = 1.0, 1.0, 0.15
"""Beliefs: lag and dead time within a factor of e, the calibrated edge within 15 %."""
PLACE_PX = 0.3
"""Belief: edges lie within this distance of where they are expected, px."""
USUAL_LAG_US, USUAL_DEAD_US = 100.0, 100.0
"""Middles of these beliefs, us: a photoreceptor of 1.6 kHz in the bright light (sensors: 0.5 to
5 kHz), a refractory period of 100 us (sensors: 10 to 1,000)."""
STRENGTHS = 7
"""Amplitudes for which events are expected; between them they are interpolated."""
FINER = 2
"""Distances within a ring."""
EVALUATIONS = 8
"""Steps of a fit at the most."""
LEAST_EVENTS = 0.1
"""Events of the most active cell per cycle below which no amplitude is given (ours)."""
GUESSES_PX = (0.27, 0.9)
"""Amplitudes from which fits begin, px: the better of the two is kept."""
DIFFERENCE = 1e-3
"""Relative step of the derivatives."""


@dataclass(frozen=True, slots=True)
class RimCounts:
    """What was counted over a whole number of cycles, or many.

    Attributes:
        hz: Frequency, Hz.
        per_cycle: ``(2, RINGS, SECTORS)`` events of a pixel per cycle, OFF and ON.
        pixels: ``(RINGS, SECTORS)`` pixels in each cell.
        across: ``(SECTORS,)`` share of the amplitude that each direction sees, at most 1.
        white: True for white markers on dark ground.
    """

    hz: float
    per_cycle: Field
    pixels: NDArray[np.int64]
    across: Field
    white: bool


@dataclass(frozen=True, slots=True)
class Amplitude:
    """An amplitude, px.

    Attributes:
        px: Of the sine along its main direction, px; None where too few events tell it.
        sigma_px: One standard deviation, px; None with it.
    """

    px: float | None
    sigma_px: float | None


UNTOLD = Amplitude(None, None)


def rim_amplitude(counted: RimCounts, edge: Edge) -> Amplitude:
    """Return the amplitude that explains the counts best.

    Args:
        counted: The events.
        edge: The calibrated edge; its lag and dead time are not used.
    """
    if float(np.median(counted.per_cycle, axis=2).max()) < LEAST_EVENTS:
        return UNTOLD
    weight = np.sqrt(counted.pixels / max(1.0, float(counted.pixels.mean()))) / COUNT_ERROR
    beliefs = np.array([LOG_LAG, LOG_DEAD, PLACE_PX, LOG_WIDTH])

    def misfit(values: Field) -> Field:
        missing = (_expected(values, counted, edge) - counted.per_cycle) * weight
        return np.concatenate([missing.ravel(), values[1:] / beliefs])

    fits = [
        least_squares(
            misfit,
            np.array([np.log(guess_px), 0.0, 0.0, 0.0, 0.0]),
            diff_step=DIFFERENCE,
            max_nfev=EVALUATIONS,
            x_scale=[0.1, 0.3, 0.3, 0.1, 0.1],
        )
        for guess_px in GUESSES_PX
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    amplitude_px = float(np.exp(best.x[0]))
    scatter = max(1.0, 2.0 * float(best.cost) / len(best.fun))
    sigma = float(np.sqrt(np.linalg.pinv(best.jac.T @ best.jac)[0, 0] * scatter))
    return Amplitude(amplitude_px, amplitude_px * sigma)


def _expected(values: Field, counted: RimCounts, edge: Edge) -> Field:
    """Return ``(2, RINGS, SECTORS)`` events of a pixel per cycle."""
    amplitude, lag, dead, shift_px, width = values.tolist()
    pixel = replace(
        edge,
        width_px=edge.width_px * float(np.exp(width)),
        lag_us=USUAL_LAG_US * float(np.exp(lag)),
        dead_us=USUAL_DEAD_US * float(np.exp(dead)),
    )
    fine = (np.arange(FINER) + 0.5) / FINER * RING_PX - 0.5 * RING_PX
    distance = (ring_distances_px()[:, None] + fine).ravel() - shift_px
    strengths = np.linspace(0.0, 1.0, STRENGTHS)
    towards_dark = distance if counted.white else -distance
    table = edge_counts(towards_dark, float(np.exp(amplitude)) * strengths, counted.hz, pixel)
    table = table.reshape(2, STRENGTHS, RINGS, FINER).mean(axis=3)
    at = np.clip(counted.across, 0.0, 1.0) * (STRENGTHS - 1)
    low = np.minimum(at.astype(np.int64), STRENGTHS - 2)
    share = (at - low)[:, None]
    found = table[:, low] * (1.0 - share) + table[:, low + 1] * share
    return found.transpose(0, 2, 1)
