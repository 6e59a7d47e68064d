"""Locate markers by disc fits on the graded map, each one when its events ask for it.

A map without new events gives the same fit again: silence measures the last place once more, and
costs nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import appearance_of, painted_levels, painted_map, roam_px
from spikingtac.markers.graded.disc_fit import SMALL_STEP_PX, fit_disc_kernel
from spikingtac.markers.graded.fit_window import FitWindow, fit_window
from spikingtac.markers.graded.motion import (
    AT_US,
    MEASUREMENT_PERIOD_S,
    PP,
    VX,
    VY,
    X,
    Y,
    correct_kernel,
    predict_kernel,
    resting_motion,
)
from spikingtac.state_map.graded import GradedStateMap

STILL_PX_S = 0.2
"""Filtered speed below which a marker without new events is not moved on (ours)."""

DUE_PX = 0.02
"""Motion whose events ask for a fit at once, px (ours)."""

LATE_S = 2.0e-3
"""Fewer events are looked at after this time, s (ours: as long as a prediction serves)."""

OUTLINE_PER_S = 150.0
"""Rate at which an outline follows what the fit sees, 1/s (ours: indentation and strain take tens
of ms)."""

AT_ONCE = 1 << 30
"""Events that are due for any marker."""

LARGEST_FALL = 0.05
"""Fall of the agreement that tells of a marker that snapped away (ours: a snap of 14 px costs 0.15
within 3 ms; 0.05 to 0.10 are equally good on a small simulated sensor)."""

FIT_X, FIT_Y, FIT_US, AGREEMENT = range(4)
"""Columns of a fit: place, px; its time, us; share of the edge that agrees with the disc."""


class DiscLocator:
    """Robust Gauss-Newton fits and a Kalman filter for each marker.

    Attributes:
        map: The graded map that it reads.
        motion: ``(m, 8)`` states of the markers, by the columns above.
        outline_px: ``(m, 3)`` radius and second harmonic of each disc, px.
        pending: ``(m,)`` events in each marker's cell since its last fit.
        largest_fall: By how much the agreement of a fit that follows its marker falls at most.
    """

    largest_fall = LARGEST_FALL

    def __init__(
        self, calibration: Calibration, events_per_px: NDArray[np.float64], iterations: int
    ) -> None:
        """Choose the pixels and the profiles for a sensor's markers.

        Args:
            calibration: Where they rest and how they look.
            events_per_px: ``(m,)`` events that a px of motion causes.
            iterations: Gauss-Newton steps of a fit at most.
        """
        self._calibration = calibration
        self._start_px = calibration.reference_px.astype(np.float64)
        self._radius_px = calibration.radius_px.astype(np.float64)
        self.map = painted_map(calibration, GradedStateMap)
        self._window = fit_window(appearance_of(calibration).profiles, calibration.size[0])
        self._edge = np.empty((5, self._window.offset.size), np.float32)
        self._due = np.maximum(np.ceil(DUE_PX * events_per_px), 1.0)
        self._iterations = iterations
        # Farther from its rest a disc throws a part of its events into another marker's cell.
        self._roam_px = roam_px(calibration)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self.map.reset()
        self._rest(self._start_px)

    def begin_at(self, position_px: NDArray[np.float64]) -> None:
        """Begin with ``(m, 2)`` markers at rest elsewhere, px; the steps of the map stay."""
        self.map.repaint(painted_levels(self._calibration, position_px))
        self._rest(position_px)

    def _rest(self, position_px: NDArray[np.float64]) -> None:
        count = len(position_px)
        self.motion = resting_motion(position_px)
        self._fits = np.zeros((count, 4))
        self._fits[:, :FIT_US], self._fits[:, AGREEMENT] = position_px, 1.0
        self.outline_px = np.column_stack([self._radius_px, np.zeros((count, 2))])
        self.pending = np.zeros(count, np.int64)

    def place(self, marker: NDArray[np.bool_], position_px: NDArray[np.float64]) -> None:
        """Put markers somewhere at rest, after they were found again or predicted."""
        self.motion[marker, X:VX] = position_px[marker]
        self.motion[marker, VX:PP] = 0.0
        self.pending[marker] = AT_ONCE

    @property
    def agreement(self) -> NDArray[np.float64]:
        """``(m,)`` share of each edge that agrees with its disc, 0 to 1; a view."""
        return self._fits[:, AGREEMENT]

    @property
    def fitted_px(self) -> NDArray[np.float64]:
        """``(m, 2)`` where the discs were found, px; a view."""
        return self._fits[:, :FIT_US]

    def locate(self, t_us: int, coasted: NDArray[np.bool_]) -> None:
        """Bring the motion of every marker that asks for it up to ``t_us``."""
        locate_discs_kernel(
            (self.map.padded, self._edge),
            self._window,
            (self.motion, self._fits, self.outline_px, self.pending, coasted),
            (self._radius_px, self._due, self._start_px),
            (t_us, self._iterations, self._roam_px),
        )


@njit(cache=True, nogil=True)
def locate_discs_kernel(
    levels: tuple[NDArray[np.float32], NDArray[np.float32]],
    window: FitWindow,
    states: tuple[Any, ...],
    discs: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    settings: tuple[int, int, float],
) -> None:  # pragma: no cover - compiled
    """Fit the markers that enough events ask for, and bring the filters up to the present.

    Args:
        levels: The map with its margin, and scratch (:func:`fit_disc_kernel`).
        window: The pixels and profiles.
        states: Motions, fits, outlines, pending events, and which markers are held.
        discs: ``(m,)`` radii at rest, px; ``(m,)`` events that ask for a fit; ``(m, 2)`` rests, px.
        settings: The time, us; Gauss-Newton steps at most; how far from its rest a marker's events
            are counted for it, px.
    """
    motions, fits, outline_px, pending, coasted = states
    radius_px, due, rest_px = discs
    t_us, iterations, near_px = settings
    for m in range(radius_px.size):
        motion, fit = motions[m], fits[m]
        if motion[AT_US] < 0.0:
            motion[AT_US] = fit[FIT_US] = t_us
        dt_s, since_s = (t_us - motion[AT_US]) * 1e-6, (t_us - fit[FIT_US]) * 1e-6
        away_px = abs(motion[X] - rest_px[m, 0]) + abs(motion[Y] - rest_px[m, 1])
        waits = pending[m] > 0 if away_px < near_px else since_s >= MEASUREMENT_PERIOD_S
        asked = pending[m] >= due[m] or (waits and (since_s >= LATE_S or away_px >= near_px))
        if not asked and (pending[m] > 0 or dt_s < MEASUREMENT_PERIOD_S):
            continue
        motion[AT_US] = t_us
        if not asked and abs(motion[VX]) + abs(motion[VY]) < STILL_PX_S:
            continue
        predict_kernel(motion, dt_s)
        if asked:
            gain = 1.0 - np.exp(-since_s * OUTLINE_PER_S)
            x, y, fit[AGREEMENT], step_px = fit_disc_kernel(
                levels,
                window,
                m,
                (motion[X], motion[Y]),
                outline_px[m],
                (iterations, gain, radius_px[m]),
            )
            fit[FIT_X], fit[FIT_Y], fit[FIT_US] = x, y, t_us
            pending[m] = AT_ONCE if step_px >= SMALL_STEP_PX else 0
        if coasted[m]:
            motion[VX] = motion[VY] = 0.0
        else:
            correct_kernel(motion, fit[FIT_X], fit[FIT_Y], dt_s)
