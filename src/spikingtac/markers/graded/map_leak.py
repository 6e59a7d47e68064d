"""The leak of the graded map towards the fitted discs, and of the ground towards its level.

Noise and lost events leave errors in the map's sums that no later event removes. Where the level of
a pixel is off by more than a tolerance, it gives up a share of the excess; nothing leaks on the
edge itself, where a slow marker is a little ahead of its fit and would be held back.

So nothing anchors the edge of a marker that never swings its pixels fully: noise moves the edge of
the map, the outline follows it, and both drift together. At rest, therefore, edges are drawn
towards their calibrated radii, which leaves the centre alone (simulated, 20 s of 1 Hz/px: a radius
of 7 px grows by 0.4 px, and without by 1.8 px).

Nor does anything leak where the agreement with the map has just fallen: a marker that snaps back
faster than its fit goes would be erased by the disc that is painted anew (measured: a snap of 14 px
at 10 px/ms; the marker was given 8 px off, with a confidence of 0.99).
"""

import math
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import FitWindow, appearance_of
from spikingtac.markers.graded.disc_fit import (
    MOST_GROWTH,
    SAME_BITS,
    Ring,
    fit_scratch,
    read_kernel,
)
from spikingtac.markers.graded.disc_locator import DiscLocator
from spikingtac.markers.graded.motion import AGREEMENT, AT_US, FIT_US, VX, VY, X, Y
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX, Array

# Time in which a marker's agreement becomes usual, s (a fit that may still follow its
# marker does so within 0.1 s).
USUAL_S = 0.2

# Disagreement that is left alone, in mean steps of the marker; and until it is known how many
# events are lost: a faint touch brings too few to tell, and a leak that holds discs back blurs it.
TOLERANCE, FIRST_TOLERANCE = 0.3, 1.0

# How far outside of a disc the leak works, px. (At 5 px a marker is lost at a snap of the twin; at
# 3.5 px v2e's recording without 30 % of its events errs by 2 % more.)
OUTER_PX = 4.0

# Rate at which the edges of resting discs are drawn to their calibrated radii, 1/s.
DRAWN_PER_S = 0.3

# Speed below which a marker counts as resting: creep, and the jitter of a filtered velocity.
AT_REST_PX_S = 3.0

# Rate at which the ground away from all discs returns to its level, 1/s. What noise adds up there
# draws a disc that comes near: after 40 s of rest with 1 Hz/px, v2e's gel errs by 0.18 px (0.20 px
# at a rate of 0.3, 0.87 px without; simulated). Above 2 nothing more is gained.
GROUND_PER_S = 2.0

# The leak visits every n-th marker per turn: each one every 32 ms where turns are 1 ms apart.
# Less work, same effect.
GROUPS = 32

# Turns in which all rows of the ground are visited once: a row or two of 320 in each.
GROUND_TURNS = 256

# Fall of the agreement that tells of a marker that snapped away (a snap of 14 px costs 0.15
# within 3 ms; 0.05 to 0.10 are equally good on a small simulated sensor).
LARGEST_FALL = 0.05

# Time without a fit, and so without events, after which a marker has leaked, us.
LEAKED_US = 1_000_000


class MapLeak:
    """Lets the map around some markers leak towards their discs, and the ground return, in turn."""

    def __init__(self, calibration: Calibration, leak_per_s: float) -> None:
        """Begin without a usual agreement.

        Args:
            calibration: How the markers look.
            leak_per_s: Rate at which pixels give up their disagreement, 1/s.
        """
        appearance = appearance_of(calibration)
        steepest = np.array([profile.steepest for profile in appearance.profiles])
        radius_px = calibration.radius_px.astype(np.float64)
        self._discs = radius_px, steepest, appearance.mean_step
        self._scratch = fit_scratch((1.0 + MOST_GROWTH) * radius_px.max() + OUTER_PX)
        self._leak_per_s = leak_per_s
        self._usual = np.ones(len(steepest))
        self._turn = 0

    def update(self, locator: DiscLocator, dt_s: float, known: bool) -> None:
        """Do the next turn.

        Args:
            locator: What fits the markers, and its map, which is changed.
            dt_s: Time since the last turn, s.
            known: Whether it was seen how many events are lost.
        """
        tolerance = TOLERANCE if known else FIRST_TOLERANCE
        self._turn += 1
        discs = locator.motion, locator.fits, locator.outline_px, self._usual
        take_turn_kernel(
            locator.map.padded.ravel(), locator.map.pixels, *discs, *locator.window,
            self._scratch, *self._discs, self._turn, dt_s, self._leak_per_s, tolerance,
        )  # fmt: skip


@kernel(forceinline=True, fastmath=SAME_BITS)
def _excess_kernel(
    ring: Ring, edge: Array, law: tuple[Any, Any, Any, Any]
) -> None:  # pragma: no cover - compiled
    """Write what each pixel of a disc gives up in place of its level.

    ``law`` is the disagreement that is left alone, the share of what is above, how far the edge is
    drawn inwards, in levels, and 1 over the steepest slope.
    """
    limit, portion, drawn, per_steepest = law
    half, one = np.float32(0.5), np.float32(1.0)
    for j in range(ring[3]):
        level, slope = edge[1, j], edge[2, j] * per_steepest
        # Inside of its edge a disc is all marker; the edge's foot goes on outside.
        level = one if slope == np.float32(0.0) and level > half else level
        e = edge[0, j] - level
        excess = e - min(max(e, -limit), limit)
        edge[0, j] = portion * (one - np.sqrt(slope)) * excess + drawn * slope


@kernel(forceinline=True)
def _give_kernel(
    flat: Array, pixels: Array, at: tuple[Any, Any], ring: Ring, offset: Array, edge: Array
) -> None:  # pragma: no cover - compiled
    """Take what pixels give up off their sums, and off the levels that are shown.

    ``at`` is where the middle of the ring lies: row and column.
    """
    phase, zero, one = ring[0], np.float32(0.0), np.float32(1.0)
    middle = (at[0] + PAD_PX) * (pixels.shape[1] + 2 * PAD_PX) + at[1] + PAD_PX
    for j in range(ring[2]):
        shown = np.uint64(middle + offset[phase, 0, j])
        if flat[shown] != OUTSIDE_LEVEL:
            row, column = at[0] + offset[phase, 1, j], at[1] + offset[phase, 2, j]
            pixel = pixels[np.uint64(row), np.uint64(column)]
            old = pixel.level
            pixel.level = min(max(old - edge[0, j], zero), one)
            flat[shown] += pixel.level - old


@kernel()
def return_ground_kernel(
    flat: Array, pixels: Array, markers: int, rows: tuple[int, int], law: tuple[float, float]
) -> None:  # pragma: no cover - compiled
    """Draw every n-th row of the ground, away from all discs, towards its own level, 0.

    A pixel of the ground rightly remembers a level of up to a step, within which it sends no event.
    What is above is noise.

    Args:
        flat: The flat map with its margin; changed.
        pixels: ``(height, width)`` of PIXEL; their sums are changed.
        markers: Their number, which stands where a pixel lies around none.
        rows: The first row, and n.
        law: The step, and which share of the level above it is given up.
    """
    (height, width), (first, every) = pixels.shape, rows
    step, portion = np.float32(law[0]), np.float32(law[1])
    for row in range(first, height, every):
        begin = (row + PAD_PX) * (width + 2 * PAD_PX) + PAD_PX
        for column in range(width):
            pixel = pixels[row, column]
            if pixel.around == markers and pixel.level > step:
                change = portion * (pixel.level - step)
                pixel.level -= change
                flat[begin + column] -= change


@kernel()
def take_turn_kernel(
    flat: Array, pixels: Array, motions: Array, fits: Array, outline_px: Array, usual: Array,
    offset: Array, around: Array, within: Array, coefficients: Array, ends: Array, edge: Array,
    radius_px: Array, steepest: Array, mean_step: Array, turn: int, dt_s: float,
    leak_per_s: float, tolerance: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Let some markers' surroundings leak, and some rows of the ground return.

    Arguments are plain, since a tuple costs a microsecond: the flat map with its margin, and its
    pixels; motions, fits and outlines of the discs, and their usual agreements; the fields of a
    :class:`FitWindow`, and scratch; their radii at rest, px, steepest slopes, 1/px, and steps; the
    turn, the time since the last one, s, the rate of the leak, 1/s, and the disagreement that is
    left alone, in steps.
    """
    levels = flat, pixels.shape[1], pixels.shape[0]
    window = FitWindow(offset, around, within, coefficients, ends)
    portion = np.float32(-math.expm1(-leak_per_s * dt_s * GROUPS))
    drawing = -math.expm1(-DRAWN_PER_S * dt_s * GROUPS)
    for m in range(turn % GROUPS, usual.size, GROUPS):
        quiet = motions[m, AT_US] - fits[m, FIT_US] > LEAKED_US
        if quiet or fits[m, AGREEMENT] < usual[m] - LARGEST_FALL:
            continue
        place_px, ends_px = (motions[m, X], motions[m, Y]), (0.0, outline_px[m, 0] + OUTER_PX)
        ring, at = read_kernel(levels, window, m, place_px, ends_px, outline_px, edge)
        rests = np.hypot(motions[m, VX], motions[m, VY]) <= AT_REST_PX_S
        drawn = np.float32(drawing * rests * (outline_px[m, 0] - radius_px[m]) * steepest[m])
        limit = np.float32(tolerance * mean_step[m])
        _excess_kernel(ring, edge, (limit, portion, drawn, np.float32(1.0 / steepest[m])))
        _give_kernel(flat, pixels, at, ring, offset, edge)
    follows = -math.expm1(-dt_s / USUAL_S)
    for m in range(usual.size):
        usual[m] += follows * (fits[m, AGREEMENT] - usual[m])
    share = -math.expm1(-GROUND_PER_S * dt_s * GROUND_TURNS)
    rows, law = (turn % GROUND_TURNS, GROUND_TURNS), (mean_step.mean(), share)
    return_ground_kernel(flat, pixels, usual.size, rows, law)
