"""Signed evidence of the markers' events for a motion, and a sequential test of its sums.

A bright disc that moves in direction d brightens the pixels of its leading rim and darkens those of
its trailing rim. An event of polarity p = +-1 at the angle phi of the rim is therefore evidence for
a motion along p (cos phi, sin phi): to first order this vector is the event's contribution to the
log-likelihood ratio of a small motion. Events that do not come from motion (background, leak,
flicker of the light) cancel around the rim.

A motion that begins at an unknown time and runs at an unknown speed shows best in the sum since its
beginning. The generalised likelihood ratio over the time of change is therefore the largest of the
whitened squared sums; testing n = 1, 2, 4, ... loses at most a factor of sqrt(2) in time (Lai,
"Sequential change-point detection in quality control and dynamical systems", J. R. Stat. Soc. B 57,
1995, window-limited rules).

One more sum measures the distance of the discs from their rest positions in any direction: a
displaced disc leaves the inside of its rim darker and the outside brighter than at rest. A pixel
that came back still lacks its last event, so each counts from its second event away on.

A change of the light fires pixels everywhere, with one polarity. Once a marker has moved, its rim's
pixels are unevenly close to their thresholds, and their events need not cancel. The events beside
the rims tell how many on the rims come from the light: so many may all point one way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import nearest_rims
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import Window, packets_of
from spikingtac.errors import ConfigError
from spikingtac.types import FloatArray

# Modes of motion of the whole field: see :func:`affine_field`.
AFFINE_MODES = 6
# The seventh sum is the distance from rest: see :func:`distance_of`; the last counts the events
# beside the rims, of either polarity.
BESIDE, MODES = AFFINE_MODES + 1, AFFINE_MODES + 2
OFF_RIM = -1  # Row of a pixel that lies on no rim.

# Width of a rim inside and outside of the radius, px. The first events of a contact come from where
# the log intensity is steepest: at the rim and a little outside of it.
INSIDE_PX, OUTSIDE_PX = 2.0, 3.0

# Whitened length of the light's share, standard deviations, beyond which the polarities are
# compared, and least agreement of theirs: their product over the larger square. (Motions are near
# 0.5 and more, steps of the light below 0.1. Of 42 false contacts in 88 simulated steps and
# blinks, 18 stay without the comparison, 13 without the share, 11 with both.)
CLEAR_LIGHT, LEAST_AGREEMENT = 3.0, 0.25


class RimTable(NamedTuple):
    """The rim pixels of one sensor.

    Attributes:
        row: ``int32[height, width]`` row of each pixel in ``modes``, or :data:`OFF_RIM`.
        modes: ``float32[n, BESIDE]`` evidence of an ON event of the pixel for each motion of the
            whole field, and for a distance from the rest; an OFF event gives the opposite. The
            first two modes are the translations: there the evidence is the rim's outward unit
            vector, in image axes.
        steps: ``(2,)`` change of a pixel's level by an OFF and by an ON event, 1 on average.
        level: ``(n,)`` level of each row's pixel, from where it was first. Its events change it.
        markers: Number of markers.
    """

    row: NDArray[np.int32]
    modes: NDArray[np.float32]
    steps: FloatArray
    level: FloatArray
    markers: int

    def without(self, pixels: NDArray[np.bool_]) -> RimTable:
        """Return a table that ignores the given pixels ``bool[height, width]``."""
        return self._replace(row=np.where(pixels, OFF_RIM, self.row).astype(np.int32))


def rim_table(calibration: Calibration) -> RimTable:
    """Return the rim pixels of a sensor's markers, each assigned to the nearest rim."""
    owner, offset, depth = nearest_rims(calibration)
    on_rim = (depth >= -INSIDE_PX) & (depth <= OUTSIDE_PX) & offset.any(axis=2)
    row = np.where(on_rim, on_rim.cumsum().reshape(on_rim.shape) - 1, OFF_RIM)
    outward = offset[on_rim] / np.linalg.norm(offset[on_rim], axis=1, keepdims=True)
    sign = -1.0 if calibration.polarity == "dark" else 1.0
    field = affine_field(calibration.reference_px)[owner[on_rim]]
    along = np.einsum("na,nak->nk", outward, field)
    side = np.sign(depth[on_rim])
    # Without their mean: ON events at a uniform rate, as from leak, give no distance.
    modes = sign * np.column_stack([along, side - side.sum() / max(len(side), 1)])
    steps = np.array([-(calibration.step_off or 1.0), calibration.step_on or 1.0])
    steps /= np.abs(steps).mean()
    columns = row.astype(np.int32), modes.astype(np.float32), steps, np.zeros(len(modes))
    return RimTable(*columns, len(calibration.reference_px))


def affine_field(points_px: FloatArray) -> FloatArray:
    """Return ``(m, 2, AFFINE_MODES)``: motion of each point in each mode, about the mean point.

    The modes are two translations, rotation, dilation and two shears; all but the translations are
    scaled to a root mean square of 1 over the points. They span every motion that is affine in the
    position: a rod that shifts and turns between the pads, a pad that is pressed evenly.
    """
    points = np.asarray(points_px, np.float64)
    away = points - points.mean(axis=0)
    size = float(np.sqrt((away**2).sum(axis=1).mean())) or 1.0
    x, y = (away / size).T
    one, none = np.ones(len(points)), np.zeros(len(points))
    along_x = np.column_stack([one, none, -y, x, x, y])
    return np.stack([along_x, np.column_stack([none, one, x, y, -y, x])], axis=1)


POLARITIES = 2  # OFF and ON evidence are summed apart: the leak of the pixels fires ON only.


def evidence_of(window: Window, tables: Sequence[RimTable]) -> FloatArray:
    """Return a window's evidence ``(length,)``: by sensor, OFF before ON, by mode.

    Args:
        window: The events of one period.
        tables: The rims of each sensor, in the window's order; their pixels' levels change.

    Raises:
        ConfigError: The window has another number of sensors, or sensors of another size.
    """
    packets = packets_of(window)
    if len(packets) != len(tables):
        raise ConfigError(
            f"the windows hold {len(packets)} sensors, the detector was built for {len(tables)}"
        )
    evidence = np.zeros((len(tables), POLARITIES, MODES))
    for packet, table, sums in zip(packets, tables, evidence, strict=True):
        packet.require_map(table.row.shape)
        evidence_kernel(packet.x, packet.y, packet.p, *table[:4], sums)
    return evidence.ravel()


def distance_of(evidence: FloatArray) -> Any:
    """Return the evidence for a distance of the markers from rest, over all sensors.

    Args:
        evidence: ``(..., length)``, of one window or of many.
    """
    return evidence[..., AFFINE_MODES::MODES].sum(axis=-1)


@njit(cache=True)
def evidence_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: NDArray[np.bool_],
    row: NDArray[np.int32],
    modes: NDArray[np.float32],
    steps: FloatArray,
    level: FloatArray,
    evidence: FloatArray,
) -> None:
    """Add a packet's evidence to ``evidence (2, modes)`` by polarity.

    A pixel may be off its level by the step to its next event, either way: only what lies beyond
    is a distance. So a pixel that came back, but for the event that it lacks, is back.

    The table's columns are separate parameters: a call with a tuple of arrays takes twice as long.
    """
    for event in range(len(x)):
        place = row[y[event], x[event]]
        polarity = 1 if p[event] else 0
        if place == OFF_RIM:
            evidence[polarity, BESIDE] += 1.0
        else:
            for mode in range(AFFINE_MODES):
                evidence[polarity, mode] += (2 * polarity - 1) * modes[place, mode]
            before, after = level[place], level[place] + steps[polarity]
            within = min(max(after, -steps[1]), -steps[0]) - min(max(before, -steps[1]), -steps[0])
            evidence[polarity, AFFINE_MODES] += (after - before - within) * modes[place, -1]
            level[place] = after


class ScaleTest(NamedTuple):
    """The tests of all time scales, ready to be applied.

    Attributes:
        windows: ``int64[s]`` number of windows in each scale's sum, increasing.
        whiten: ``(s, d, length)`` maps the evidence of a scale to d numbers, each of variance 1 or
            less without contact.
        chance: ``(s,)`` length that the light's events on the rims may have, all pointing one way,
            for each event beside the rims.
        mean: ``(length,)`` evidence per window without contact.
        threshold: ``(s,)`` squared length that calls a contact.
    """

    windows: NDArray[np.int64]
    whiten: FloatArray
    chance: FloatArray
    mean: FloatArray
    threshold: FloatArray


class ScaleSums:
    """Keeps running sums of the evidence, and applies the tests to them.

    Args:
        test: The tests.
    """

    def __init__(self, test: ScaleTest) -> None:
        self._test = test
        self._ring = np.zeros((int(test.windows[-1]) + 1, test.whiten.shape[2]))
        self._values = np.zeros(len(test.windows))
        self._seen = 0

    def add(self, evidence: FloatArray) -> FloatArray:
        """Take the evidence of the next window; return the statistic of each scale.

        Scales longer than the time since the start have the statistic 0. The next call overwrites
        the array.
        """
        self._seen = scales_kernel(evidence, *self._test[:4], self._ring, self._seen, self._values)
        return self._values

    def total(self, scale: int) -> FloatArray:
        """Return the evidence ``(length,)`` of the windows that a scale sums now."""
        now = self._seen % len(self._ring)
        start = (self._seen - int(self._test.windows[scale])) % len(self._ring)
        return self._ring[now] - self._ring[start]

    def reset(self) -> None:
        """Forget all sums."""
        self._ring[:] = 0.0
        self._seen = 0


@njit(cache=True)
def scales_kernel(
    evidence: FloatArray,
    windows: NDArray[np.int64],
    whiten: FloatArray,
    chance: FloatArray,
    mean: FloatArray,
    ring: FloatArray,
    seen: int,
    values: FloatArray,
) -> int:
    """Add a window to the ring of running sums; write each scale's squared whitened sum.

    The share of the light is taken from its length.

    Returns:
        The number of windows so far, this one included.
    """
    slots = ring.shape[0]
    before, now = seen % slots, (seen + 1) % slots
    ring[now] = ring[before] + evidence - mean
    seen += 1
    for scale in range(len(values)):
        values[scale] = 0.0
        if windows[scale] > seen:
            continue
        total = ring[now] - ring[(seen - windows[scale]) % slots]
        light = chance[scale] * np.maximum(total[BESIDE::MODES], 0.0).sum()
        sums = total.reshape(-1, POLARITIES, MODES)[:, :, :AFFINE_MODES]
        off, on = sums[:, 0], sums[:, 1]
        least = LEAST_AGREEMENT * max((off * off).sum(), (on * on).sum())
        if light <= CLEAR_LIGHT or (off * on).sum() >= least:
            square = ((whiten[scale] * total).sum(axis=1) ** 2).sum()
            values[scale] = max(square**0.5 - light, 0.0) ** 2
    return seen
