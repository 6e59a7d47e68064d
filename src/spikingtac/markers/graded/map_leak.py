"""Leak of the graded map: its levels relax towards the fitted discs, and the ground towards 0.

Noise and lost events leave errors in the map that no later event removes. Where a pixel's level
differs from the fitted disc by more than a tolerance, a share of the excess is removed. Nothing
leaks on the edge itself, where a slow marker leads its fit a little and would be held back.

So nothing anchors the edge of a marker that never moves its pixels through a full swing: noise
shifts the edge of the map, the outline follows, and both drift together, until the outline is at
its limit and the disc stays behind its marker. At rest, therefore, edges are pulled towards their
calibrated radii as fast as noise shifts them, which leaves the centre alone.

Nor does anything leak where the agreement with the map has just fallen: a marker that snaps back
faster than its fit converges would be erased by its own old disc (measured: at a snap of 14 px at
10 px/ms the marker was estimated 8 px off, with a confidence of 0.99).
"""

import math
from typing import Any

import numpy as np

from spikingtac.calibration.disc_profile import Discs
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import FitWindow, steps_of
from spikingtac.markers.graded.disc_fit import SAME_BITS, Ring, sample_ring_kernel
from spikingtac.markers.graded.disc_locator import OUTER_PX, DiscLocator
from spikingtac.markers.graded.motion import AT_REST_PX_S
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX, Array

# Time constant of the mean agreement, s (a fit that can still reach its marker does so within
# 0.1 s).
AGREEMENT_MEMORY_S = 0.2

TOLERANCE = 0.3  # Tolerated disagreement, in mean steps of the marker.

# Rate at which the edges of resting discs are pulled to their calibrated radii, 1/s; beyond a noise
# of 1 Hz/px it grows with the square of the noise. (A simulated sensor of 5 Hz/px errs by 0.50 px
# without growth, and by 0.2 px with it. Without a pull the recorded gel, which has no noise, errs
# by 0.92 px for 0.72.)
RADIUS_PULL_PER_S = 0.3

# Rate at which the ground away from all discs leaks, 1/s. Noise that accumulates there biases a
# disc that comes near: after 40 s of rest with 1 Hz/px, v2e's gel errs by 0.18 px (0.20 px at a
# rate of 0.3, 0.87 px without; simulated). Above 2 nothing more is gained.
GROUND_PER_S = 2.0

# Number of updates in which all markers leak once, a group in each: every 32 ms where updates are
# 1 ms apart. This is less work with the same effect.
GROUPS = 32

# Number of updates in which all rows of the ground leak once: a row of 320 in most of them. (256 is
# alike, and takes 1 to 5 % longer.)
GROUND_SLOTS = 512

# Fall of the agreement below its mean that reveals a marker that snapped away (a snap of 14 px
# costs 0.15 within 3 ms; 0.05 to 0.10 are equally good on a small simulated sensor).
LARGEST_FALL = 0.05

# Time without a fit, and so without events, after which a marker's map leaks no more, us.
LEAKED_US = 1_000_000


class MapLeak:
    """Lets the map leak: a group of markers and some rows of the ground at each update."""

    def __init__(self, calibration: Calibration, leak_per_s: float) -> None:
        """Begin with full agreement.

        Args:
            calibration: Appearance of the markers.
            leak_per_s: Rate at which disagreement beyond the tolerance is removed, 1/s.
        """
        self._discs = Discs.of(calibration).steepest, steps_of(calibration).mean(axis=0)
        self._leak_per_s = leak_per_s
        self._mean_agreement = np.ones(len(calibration.radius_px))
        self._count = 0

    def update(self, locator: DiscLocator, dt_s: float, noise_hz_px: float) -> None:
        """Leak the next group of markers, and the next rows of the ground.

        Args:
            locator: Fits of the markers, and their map, which is changed.
            dt_s: Time since the last update, s.
            noise_hz_px: Background, Hz/px.
        """
        self._count += 1
        discs = locator.markers, locator.outline_px, self._mean_agreement
        leak_kernel(
            locator.map.padded.ravel(), locator.map.pixels, *discs, *locator.window,
            locator.scratch, *self._discs, self._count, dt_s, self._leak_per_s, noise_hz_px,
        )  # fmt: skip


@kernel(forceinline=True, fastmath=SAME_BITS)
def _leak_disc_kernel(
    maps: tuple[Array, Array], at: tuple[Any, Any], ring: Ring, offset: Array, edge: Array,
    law: tuple[Any, Any, Any, Any],
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Remove excess from the pixels' levels, and from the expected levels of the map.

    ``at`` is row and column of the ring's centre. ``law`` holds the tolerance, the share of the
    excess that is removed, the pull of the edge inwards, in levels, and 1 over the steepest slope.
    """
    (flat, pixels), (limit, portion, pull, per_steepest), phase = maps, law, ring[0]
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    middle = (at[0] + PAD_PX) * (pixels.shape[1] + 2 * PAD_PX) + at[1] + PAD_PX
    for j in range(ring[2]):
        level, slope = edge[1, j], edge[2, j] * per_steepest
        # Inside of its edge a disc is all marker; outside the foot of the edge decays to 0.
        level = one if slope == zero and level > half else level
        e = edge[0, j] - level
        excess = e - min(max(e, -limit), limit)
        shown = np.uint64(middle + offset[phase, 0, j])
        if flat[shown] != OUTSIDE_LEVEL:
            row, column = at[0] + offset[phase, 1, j], at[1] + offset[phase, 2, j]
            pixel = pixels[np.uint64(row), np.uint64(column)]
            old = pixel.level
            loss = portion * (one - np.sqrt(slope)) * excess + pull * slope
            pixel.level = min(max(old - loss, zero), one)
            flat[shown] += pixel.level - old


@kernel()
def leak_ground_kernel(
    flat: Array, pixels: Array, markers: int, rows: tuple[int, int], law: tuple[float, float]
) -> None:  # pragma: no cover - compiled
    """Leak every n-th row of the ground, in no marker's gate, towards its level 0.

    A pixel of the ground may hold a level of up to a step, within which it sends no event. The
    excess is noise.

    Args:
        flat: The flat map with its margin; changed.
        pixels: ``(height, width)`` of PIXEL; their levels are changed.
        markers: Number of markers, which marks pixels in no gate.
        rows: The first row, and n.
        law: The step, and the share of the excess above it that is removed.
    """
    (height, width), (first, every) = pixels.shape, rows
    step, portion = np.float32(law[0]), np.float32(law[1])
    for row in range(first, height, every):
        begin = (row + PAD_PX) * (width + 2 * PAD_PX) + PAD_PX
        for column in range(width):
            pixel = pixels[row, column]
            if pixel.marker == markers and pixel.level > step:
                change = portion * (pixel.level - step)
                pixel.level -= change
                flat[begin + column] -= change


@kernel()
def leak_kernel(
    flat: Array, pixels: Array, markers: Array, outline_px: Array, mean_agreement: Array,
    offset: Array, polar: Array, within: Array, coefficients: Array, ends: Array, edge: Array,
    steepest: Array, mean_step: Array, count: int, dt_s: float, leak_per_s: float,
    noise_hz_px: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Leak the map around a group of markers and in some rows of the ground.

    Arguments are plain, since a tuple costs a microsecond: the flat map with its margin, and its
    pixels; records, outlines and mean agreements of the markers; the fields of a
    :class:`FitWindow`, and scratch; steepest slopes, 1/px, and mean steps; the count of updates,
    the time since the last one, s, the rate of the leak, 1/s, and the background, Hz/px.
    """
    levels = flat, pixels.shape[1], pixels.shape[0]
    window = FitWindow(offset, polar, within, coefficients, ends)
    portion = np.float32(-math.expm1(-leak_per_s * dt_s * GROUPS))
    pull_per_s = RADIUS_PULL_PER_S * max(noise_hz_px, 1.0) ** 2
    pull_share = -math.expm1(-pull_per_s * dt_s * GROUPS)
    for m in range(count % GROUPS, mean_agreement.size, GROUPS):
        marker = markers[m]
        quiet = marker.t_us - marker.fit_us > LEAKED_US
        if quiet or marker.agreement < mean_agreement[m] - LARGEST_FALL:
            continue
        place_px, ends_px = (marker.x, marker.y), (0.0, outline_px[m, 0] + OUTER_PX)
        ring, at = sample_ring_kernel(levels, window, m, place_px, ends_px, outline_px, edge)
        rests = np.hypot(marker.vx, marker.vy) <= AT_REST_PX_S
        pull = np.float32(pull_share * rests * (outline_px[m, 0] - marker.radius_px) * steepest[m])
        limit = np.float32(TOLERANCE * mean_step[m])
        law = limit, portion, pull, np.float32(1.0 / steepest[m])
        _leak_disc_kernel((flat, pixels), at, ring, offset, edge, law)
    gain = -math.expm1(-dt_s / AGREEMENT_MEMORY_S)
    for m in range(mean_agreement.size):
        mean_agreement[m] += gain * (markers[m].agreement - mean_agreement[m])
    share = -math.expm1(-GROUND_PER_S * dt_s * GROUND_SLOTS)
    rows, ground = (count % GROUND_SLOTS, GROUND_SLOTS), (mean_step.mean(), share)
    leak_ground_kernel(flat, pixels, mean_agreement.size, rows, ground)
