"""The leak of the graded map towards the fitted discs.

Noise and lost events leave errors in the map's sums that no later event removes. Where the level of
a pixel is off by more than a tolerance, it gives up a share of the excess; nothing leaks on the
edge itself, where a slow marker is a little ahead of its fit and would be held back.

So nothing anchors the edge of a marker that never swings its pixels fully: outline and map drift
together (measured: 0.35 px on average and 1.2 px at worst over fifty contacts). At rest, therefore,
discs are eased towards the outline that they were calibrated with, which moves the edge along its
normal and leaves the centre alone.

Nor does anything leak where the agreement with the map has just fallen: a marker that snaps back
faster than its fit goes would be erased by the disc that is painted anew (measured: a snap of 14 px
at 10 px/ms; the marker was given 8 px off, with a confidence of 0.99).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import appearance_of, profile_tables
from spikingtac.markers.graded.band_locator import BandLocator
from spikingtac.markers.graded.disc_fit import SAME_BITS
from spikingtac.markers.graded.disc_locator import VX, VY, DiscLocator, X, Y
from spikingtac.markers.periodic_task import PeriodicTask
from spikingtac.state_map.graded import PAD_PX

USUAL_S = 0.2
"""Time in which a marker's agreement becomes usual, s (ours: a fit that may still follow its
marker does so within 0.1 s)."""

TOLERANCE, LOSSY_TOLERANCE = 0.3, 1.0
"""Disagreement that is left alone, in mean steps of the marker, in a stream that is known to be
whole, and before enough motion was seen or where most events are lost. A disc that lags behind its
marker for want of events must not erase the map's evidence of it (ours)."""

OUTER_PX = 3.5
"""How far outside of a disc the leak works, px (ours)."""

EASE_PER_S = 0.3
"""Rate at which the edges of resting discs return to their calibrated outlines, 1/s (ours: over
fifty contacts on a training seed the error stays at 0.12 px; without it it grows to 0.15 px, and
the radii by 0.35 px)."""

AT_REST_PX_S = 3.0
"""Speed below which a marker counts as resting: creep, and the jitter of a filtered velocity."""

GROUND_PER_S = 0.3
"""Rate at which the ground away from all discs returns to its level, 1/s (ours: what noise adds up
there draws a disc that comes near; 0.3 to 10 are alike within 1 %)."""

PERIOD_US = 4_000
"""Time between two turns, us (ours: as the tracker's other tasks)."""

GROUPS = 8
"""The leak visits every n-th marker per turn, in turn: less work, same effect (ours)."""

MOST_LEAKING = 32
"""Markers whose surroundings leak in one turn, where the turns can be as many: 0.2 ms (ours)."""

MOST_PARTS = 4
"""Turns that a period of the leak is divided into, for many markers (ours)."""

GROUND_TURNS = 64
"""Turns of the leak in which all rows of the ground are visited once: 5 rows of 320 (ours)."""

ALL_LEVELS = 2.0
"""A tolerance that no disagreement exceeds: levels lie between 0 and 1."""


class MapLeak:
    """Lets the map around some markers leak towards their discs, and the ground return, in turn."""

    def __init__(
        self, calibration: Calibration, locator: DiscLocator | BandLocator, leak_per_s: float
    ) -> None:
        """Begin without a usual agreement.

        Args:
            calibration: How the markers look.
            locator: What fits them, and its map.
            leak_per_s: Rate at which pixels give up their disagreement, 1/s; 0 leaves it, and only
                the ground returns.
        """
        appearance = appearance_of(calibration)
        self._mean_step = appearance.mean_step
        self._radius_px = calibration.radius_px.astype(np.float64)
        self._values, self._reach_px = profile_tables(appearance.profiles)
        self._locator, self._leak_per_s = locator, leak_per_s
        self._usual: NDArray[np.float64] | None = None
        # A turn's markers are so few that it delays no estimate; each has its turn as often.
        parts = min(max(-(-len(self._radius_px) // (GROUPS * MOST_LEAKING)), 1), MOST_PARTS)
        self._task, self._groups = PeriodicTask(PERIOD_US // parts, 3 / 4), GROUPS * parts
        self._turn = 0

    def update(
        self, t_us: int, doubt: float, noise_hz_px: float, searched_px: NDArray[np.float64]
    ) -> None:
        """Do the next turn if it is due.

        Args:
            t_us: The time, us.
            doubt: How doubtful it is that all events arrive, 0 to 1.
            noise_hz_px: Events of a pixel at rest, 1/s.
            searched_px: ``(m,)`` how far around its disc each marker is looked for, px: there
                nothing changes.
        """
        dt_s = self._task.turn_s(t_us)
        if not dt_s:
            return
        self._turn += 1
        if self._leak_per_s:
            self._leak(dt_s, doubt)
        rates_hz = noise_hz_px, GROUND_PER_S
        below, above = (-np.expm1(-rate_hz * dt_s * GROUND_TURNS) for rate_hz in rates_hz)
        reach_px = self._radius_px + OUTER_PX + searched_px
        return_ground_kernel(
            self._locator.map.padded,
            self._locator.map.memory,
            (self._turn % GROUND_TURNS, GROUND_TURNS),
            (self._locator.motion, reach_px),
            (float(self._mean_step.mean()), below, above),
        )

    def _leak(self, dt_s: float, doubt: float) -> None:
        locator, some = self._locator, slice(self._turn % self._groups, None, self._groups)
        agreement = locator.agreement
        usual = agreement if self._usual is None else self._usual
        fallen = agreement < usual - locator.largest_fall
        self._usual = usual - np.expm1(-dt_s / USUAL_S) * (agreement - usual)
        tolerance = TOLERANCE + doubt * (LOSSY_TOLERANCE - TOLERANCE)
        limit = np.where(fallen, ALL_LEVELS, tolerance * self._mean_step)
        levels, time_s = (locator.map.padded, locator.map.memory), dt_s * self._groups
        discs = locator.motion[some], locator.outline_px[some], self._radius_px[some]
        tables = self._values[some], self._reach_px[some]
        leak_to_discs_kernel(
            levels, discs, tables, limit[some], -np.expm1(-self._leak_per_s * time_s)
        )
        ease_outlines_kernel(levels, discs, tables, -np.expm1(-EASE_PER_S * time_s))


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _entries_kernel(
    first_px: np.float32, dy: np.float32, shape: tuple[Any, ...], entry: NDArray[np.int32]
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


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy", forceinline=True)
def _give_kernel(
    levels: NDArray[np.float32],
    sums: NDArray[np.float32],
    entry: NDArray[np.int32],
    tables: NDArray[np.float32],
    limit: np.float32,
    portion: np.float32,
) -> None:  # pragma: no cover - compiled
    """Let a row give up its excess; without a branch, which no processor could foresee."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for k in range(entry.size):
        e = levels[k] - tables[0, entry[k]]
        excess = e - min(max(e, -limit), limit)
        old = sums[k]
        new = min(max(old - portion * tables[1, entry[k]] * excess, zero), one)
        sums[k] = new
        levels[k] += new - old


@njit(cache=True, nogil=True, fastmath=SAME_BITS, error_model="numpy")
def leak_to_discs_kernel(
    levels: tuple[NDArray[np.float32], NDArray[np.float32]],
    discs: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    tables: tuple[NDArray[np.float32], NDArray[np.float64]],
    tolerance: NDArray[np.float64],
    share: float,
) -> None:  # pragma: no cover - compiled
    """Move map pixels that disagree with the fitted disc towards it.

    Args:
        levels: The map with its margin of PAD_PX, and the clipped sums behind it; changed.
        discs: ``(m, 8)`` motions; ``(m, 3)`` r, b and c of each disc
            (:mod:`spikingtac.markers.graded.disc_fit`), px; ``(m,)`` radii at rest, px.
        tables: Values and reaches of :func:`~spikingtac.markers.graded.appearance.profile_tables`.
        tolerance: ``(m,)`` disagreement that is left alone.
        share: Share of the excess that is given up where the weight is 1.
    """
    (padded, memory), (motions, outline_px, _), (table, reach_px) = levels, discs, tables
    height, width = memory.shape
    portion, last = np.float32(share), np.float32(table.shape[2] - 1)
    entries = np.empty(width, np.int32)
    for m in range(tolerance.size):
        x, y = motions[m, X], motions[m, Y]
        limit, scale = np.float32(tolerance[m]), np.float32(0.5 * last / reach_px[m])
        outer, start = outline_px[m, 0] + OUTER_PX, np.float32(outline_px[m, 0] - reach_px[m])
        shape = np.float32(outline_px[m, 1]), np.float32(outline_px[m, 2]), start, scale, last
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            half = np.sqrt(max(outer * outer - (row - y) ** 2, 0.0))
            first = max(0, int(np.ceil(x - half)))
            after = max(min(width - 1, int(x + half)) + 1, first)
            entry = entries[: after - first]
            _entries_kernel(np.float32(first - x), np.float32(row - y), shape, entry)
            shown = padded[row + PAD_PX, PAD_PX + first : PAD_PX + after]
            _give_kernel(shown, memory[row, first:after], entry, table[m], limit, portion)


@njit(cache=True, nogil=True, error_model="numpy")
def return_ground_kernel(
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    rows: tuple[int, int],
    discs: tuple[NDArray[np.float64], NDArray[np.float64]],
    law: tuple[float, float, float],
) -> None:  # pragma: no cover - compiled
    """Draw every n-th row of the ground, away from all discs, towards its own level, 0.

    A pixel of the ground rightly remembers a level of up to a step, within which it sends no event,
    until an event of noise moves it. What is above is noise.

    Args:
        padded: The map with its margin of PAD_PX; changed.
        memory: The clipped sums behind it; changed.
        rows: The first row, and n.
        discs: ``(m, 8)`` motions; ``(m,)`` how far from their places the ground begins, px.
        law: The step, which share of the level up to it is given up, and of what is above.
    """
    (first, every), (motions, reach_px) = rows, discs
    height, width = memory.shape
    step, below, above = np.float32(law[0]), np.float32(law[1]), np.float32(law[2])
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
            old = sums[column]
            known = min(old, step)
            change = is_ground[column] * (below * known + above * (old - known))
            sums[column] = old - change
            levels[column] -= change


@njit(cache=True, nogil=True, error_model="numpy")
def ease_outlines_kernel(
    levels: tuple[NDArray[np.float32], NDArray[np.float32]],
    discs: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    tables: tuple[NDArray[np.float32], NDArray[np.float64]],
    share: float,
) -> None:  # pragma: no cover - compiled
    """Move the edges of discs at rest a share of the way towards their calibrated outlines.

    The other arguments are those of :func:`leak_to_discs_kernel`.
    """
    (padded, memory), (motions, outline_px, radius_px), (table, reach_px) = levels, discs, tables
    last = table.shape[2] - 1
    height, width = memory.shape
    for m in range(radius_px.size):
        x, y = motions[m, X], motions[m, Y]
        r, b, c = outline_px[m, 0], outline_px[m, 1], outline_px[m, 2]
        as_calibrated = r == radius_px[m] and b == 0.0 and c == 0.0
        if as_calibrated or np.hypot(motions[m, VX], motions[m, VY]) > AT_REST_PX_S:
            continue
        outer, scale = r + abs(b) + abs(c) + reach_px[m], 0.5 * last / reach_px[m]
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            for column in range(
                max(0, int(np.ceil(x - outer))), min(width - 1, int(x + outer)) + 1
            ):
                dx, dy = column - x, row - y
                rho2 = dx * dx + dy * dy + 1e-6
                bulge = (b * (dx * dx - dy * dy) + 2.0 * c * dx * dy) / rho2
                place = (np.sqrt(rho2) - r - bulge + reach_px[m]) * scale
                if 0.0 < place < last:
                    swelling = r - radius_px[m] + bulge
                    old = memory[row, column]
                    new = min(max(old + share * swelling * table[m, 2, int(place)], 0.0), 1.0)
                    memory[row, column] = new
                    padded[row + PAD_PX, column + PAD_PX] += new - old
