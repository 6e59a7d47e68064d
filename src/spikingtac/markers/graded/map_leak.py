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
from numba import njit

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import appearance_of, profile_tables
from spikingtac.markers.graded.disc_fit import SAME_BITS
from spikingtac.markers.graded.disc_locator import DiscLocator
from spikingtac.markers.graded.motion import AGREEMENT, AT_US, FIT_US, VX, VY, X, Y
from spikingtac.state_map.graded import PAD_PX, Array

# Time in which a marker's agreement becomes usual, s (a fit that may still follow its
# marker does so within 0.1 s).
USUAL_S = 0.2

# Disagreement that is left alone, in mean steps of the marker; and until it is known how many
# events are lost: a faint touch brings too few to tell, and a leak that holds discs back blurs it.
TOLERANCE, FIRST_TOLERANCE = 0.3, 1.0

OUTER_PX = 3.5  # How far outside of a disc the leak works, px.

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
        radius_px = calibration.radius_px.astype(np.float64)
        self._discs = *profile_tables(appearance.profiles), radius_px, appearance.mean_step
        self._leak_per_s = leak_per_s
        self._usual = np.ones(len(radius_px))
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
        discs = locator.motion, locator.fits, locator.outline_px, self._usual, *self._discs
        levels = locator.map.padded, locator.map.pixels["level"]
        take_turn_kernel(*levels, *discs, self._turn, dt_s, self._leak_per_s, tolerance)


@kernel(forceinline=True, fastmath=SAME_BITS)
def _entries_kernel(
    first_px: np.float32, dy: np.float32, shape: tuple[Any, ...], entry: Array
) -> None:  # pragma: no cover - compiled
    """Write which entry of the tables belongs to each pixel of a row.

    ``first_px`` and ``dy`` lead from the disc's centre to the first pixel; ``shape`` is b, c, the
    radius at which the tables begin, entries per px, and the last entry.
    """
    b, c, start, scale, last = shape
    zero = np.float32(0.0)
    for k in range(entry.size):
        dx = first_px + np.float32(np.int32(k))
        rho2 = dx * dx + dy * dy + np.float32(1e-6)
        bulge = (b * (dx * dx - dy * dy) + np.float32(2.0) * c * dx * dy) / rho2
        place = (np.sqrt(rho2) - start - bulge) * scale
        place = place if place > zero else zero
        entry[k] = np.int32(place if place < last else last)


@kernel(forceinline=True, fastmath=SAME_BITS)
def _give_kernel(
    levels: Array, sums: Array, entry: Array, table: Array, law: tuple[Any, Any, Any]
) -> None:  # pragma: no cover - compiled
    """Let a row give up its excess; without a branch, which no processor could foresee.

    ``law`` is the disagreement that is left alone, the share of what is above, and how far the edge
    is drawn inwards, px.
    """
    limit, portion, drawn = law
    zero, one = np.float32(0.0), np.float32(1.0)
    for k in range(entry.size):
        e = levels[k] - table[entry[k], 0]
        excess = e - min(max(e, -limit), limit)
        old = sums[k]
        given_up = portion * table[entry[k], 1] * excess - drawn * table[entry[k], 2]
        new = min(max(old - given_up, zero), one)
        sums[k] = new
        levels[k] += new - old


@njit(cache=True, nogil=True, error_model="numpy")
def return_ground_kernel(
    padded: Array,
    memory: Array,
    rows: tuple[int, int],
    discs: tuple[Array, Array],
    law: tuple[float, float],
) -> None:  # pragma: no cover - compiled
    """Draw every n-th row of the ground, away from all discs, towards its own level, 0.

    A pixel of the ground rightly remembers a level of up to a step, within which it sends no event.
    What is above is noise.

    Args:
        padded: The map with its margin of PAD_PX; changed.
        memory: The clipped sums behind it; changed.
        rows: The first row, and n.
        discs: ``(m, 8)`` motions; ``(m,)`` how far from their places the ground begins, px.
        law: The step, and which share of the level above it is given up.
    """
    (first, every), (motions, reach_px) = rows, discs
    height, width = memory.shape
    step, portion = np.float32(law[0]), np.float32(law[1])
    is_ground = np.empty(width, np.float32)
    for row in range(first, height, every):
        is_ground[:] = 1.0
        for m in range(reach_px.size):
            half = reach_px[m] ** 2 - (row - motions[m, Y]) ** 2
            if half >= 0.0:
                half = np.sqrt(half)
                left = min(max(int(np.ceil(motions[m, X] - half)), 0), width)
                after = max(min(int(np.floor(motions[m, X] + half)) + 1, width), left)
                is_ground[left:after] = 0.0
        sums, levels = memory[row], padded[row + PAD_PX, PAD_PX : PAD_PX + width]
        for column in range(width):
            change = is_ground[column] * portion * max(sums[column] - step, np.float32(0.0))
            sums[column] -= change
            levels[column] -= change


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy")
def take_turn_kernel(
    padded: Array, memory: Array, motions: Array, fits: Array, outline_px: Array, usual: Array,
    tables: Array, reach_px: Array, radius_px: Array, mean_step: Array, turn: int, dt_s: float,
    leak_per_s: float, tolerance: float,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Let some markers' surroundings leak, and some rows of the ground return.

    Arguments are plain, since a tuple costs a microsecond: the map and its sums; motions, fits and
    outlines of the discs, and their usual agreements; their profiles
    (:func:`~spikingtac.markers.graded.appearance.profile_tables`), radii at rest, px, and steps;
    the turn, the time since the last one, s, the rate of the leak, 1/s, and the disagreement that
    is left alone, in steps.
    """
    height, width = memory.shape
    portion = np.float32(-math.expm1(-leak_per_s * dt_s * GROUPS))
    drawing, last = -math.expm1(-DRAWN_PER_S * dt_s * GROUPS), np.float32(tables.shape[1] - 1)
    entries = np.empty(width, np.int32)
    for m in range(turn % GROUPS, usual.size, GROUPS):
        quiet = motions[m, AT_US] - fits[m, FIT_US] > LEAKED_US
        if quiet or fits[m, AGREEMENT] < usual[m] - LARGEST_FALL:
            continue
        x, y = motions[m, X], motions[m, Y]
        rests = np.hypot(motions[m, VX], motions[m, VY]) <= AT_REST_PX_S
        drawn = np.float32(drawing * rests * (outline_px[m, 0] - radius_px[m]))
        limit, scale = np.float32(tolerance * mean_step[m]), np.float32(0.5 * last / reach_px[m])
        outer, start = outline_px[m, 0] + OUTER_PX, np.float32(outline_px[m, 0] - reach_px[m])
        shape = np.float32(outline_px[m, 1]), np.float32(outline_px[m, 2]), start, scale, last
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            half = np.sqrt(max(outer * outer - (row - y) ** 2, 0.0))
            first = max(0, int(np.ceil(x - half)))
            after = max(min(width - 1, int(x + half)) + 1, first)
            entry = entries[: after - first]
            _entries_kernel(np.float32(first - x), np.float32(row - y), shape, entry)
            shown = padded[row + PAD_PX, PAD_PX + first : PAD_PX + after]
            law = limit, portion, drawn
            _give_kernel(shown, memory[row, first:after], entry, tables[m], law)
    follows = -math.expm1(-dt_s / USUAL_S)
    for m in range(usual.size):
        usual[m] += follows * (fits[m, AGREEMENT] - usual[m])
    rows = turn % GROUND_TURNS, GROUND_TURNS
    share = -math.expm1(-GROUND_PER_S * dt_s * GROUND_TURNS)
    ground = motions, radius_px + OUTER_PX
    return_ground_kernel(padded, memory, rows, ground, (mean_step.mean(), share))
