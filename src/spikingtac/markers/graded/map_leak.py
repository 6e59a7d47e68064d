"""The leak of the graded map towards the fitted discs.

Noise and lost events leave errors in the map's sums that no later event removes. Where the level of
a pixel is off by more than a tolerance, it gives up a share of the excess; nothing leaks on the
edge itself, where a slow marker is a little ahead of its fit and would be held back.

So nothing anchors the edge of a marker that never swings its pixels fully: each small motion to and
fro leaves the difference between an ON and an OFF step, the outline follows the map, the leak
follows the outline, and discs swell or shrink together with their outlines (measured: 0.35 px on
average and 1.2 px at worst over fifty contacts). At rest, therefore, discs are eased towards the
outline that they were calibrated with. This moves the edge along its normal and leaves alone what
single pixels know, and so the centre.

Nor does anything leak where the agreement with the map has just fallen: a marker that snaps back
faster than its fit goes leaves the fit on the map of the old disc, and one turn of the leak would
paint that disc anew and erase the marker (measured: a snap of 14 px at 10 px/ms; the marker was
given 8 px off, with a confidence of 0.99).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.markers.edge_equations import SAME_BITS
from spikingtac.state_map.graded import PAD_PX

USUAL_S = 0.2
"""Time in which a marker's agreement becomes usual, s (ours: a fit that may still follow its
marker does so within 0.1 s)."""

ALL_LEVELS = 2.0
"""A tolerance that no disagreement exceeds: levels lie between 0 and 1."""


class LeakTolerances:
    """How much disagreement around each marker is left alone."""

    def __init__(
        self,
        tolerance: NDArray[np.float64],
        lossy_tolerance: NDArray[np.float64],
        largest_fall: float,
    ) -> None:
        """Begin without a usual agreement.

        Args:
            tolerance: ``(m,)`` levels that are left alone in a stream that is known to be whole.
            lossy_tolerance: The same in one of which nothing is known.
            largest_fall: Agreement below its usual value by more than this has fallen.
        """
        self._tolerance, self._lossy_tolerance = tolerance, lossy_tolerance
        self._largest_fall = largest_fall
        self._usual: NDArray[np.float64] | None = None

    def update(
        self, agreement: NDArray[np.float64], dt_s: float, doubt: float
    ) -> NDArray[np.float64]:
        """Take in ``(m,)`` agreements; return ``(m,)`` levels.

        Args:
            agreement: Agreement of the fits with the map, 0 to 1.
            dt_s: Time since the last call, s.
            doubt: How doubtful it is that all events arrive, 0 to 1.
        """
        usual = agreement if self._usual is None else self._usual
        fallen = agreement < usual - self._largest_fall
        self._usual = usual + (1.0 - np.exp(-dt_s / USUAL_S)) * (agreement - usual)
        tolerance = self._tolerance + doubt * (self._lossy_tolerance - self._tolerance)
        return np.where(fallen, ALL_LEVELS, tolerance)


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
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    center_px: NDArray[np.float64],
    outline_px: NDArray[np.float64],
    tables: tuple[NDArray[np.float32], NDArray[np.float64]],
    outer_px: float,
    tolerance: NDArray[np.float64],
    share: float,
) -> None:  # pragma: no cover - compiled
    """Move map pixels that disagree with the fitted disc towards it.

    Args:
        padded: The map with its margin of PAD_PX; changed.
        memory: The clipped sums behind it; changed.
        center_px: ``(m, 2)`` disc centres, px.
        outline_px: ``(m, 3)`` r, b and c of each disc (:mod:`spikingtac.markers.graded.disc_fit`),
            px.
        tables: Values and reaches of `profile_tables.ProfileTables`.
        outer_px: How far outside of a disc the leak works, px.
        tolerance: ``(m,)`` disagreement that is left alone.
        share: Share of the excess that is given up where the weight is 1.
    """
    table, reach_px = tables
    height, width = memory.shape
    portion, last = np.float32(share), np.float32(table.shape[2] - 1)
    entries = np.empty(width, np.int32)
    for m in range(center_px.shape[0]):
        x, y = center_px[m, 0], center_px[m, 1]
        limit, scale = np.float32(tolerance[m]), np.float32(0.5 * last / reach_px[m])
        outer, start = outline_px[m, 0] + outer_px, np.float32(outline_px[m, 0] - reach_px[m])
        shape = np.float32(outline_px[m, 1]), np.float32(outline_px[m, 2]), start, scale, last
        for row in range(max(0, int(np.ceil(y - outer))), min(height - 1, int(y + outer)) + 1):
            half = np.sqrt(max(outer * outer - (row - y) ** 2, 0.0))
            first = max(0, int(np.ceil(x - half)))
            after = max(min(width - 1, int(x + half)) + 1, first)
            entry = entries[: after - first]
            _entries_kernel(np.float32(first - x), np.float32(row - y), shape, entry)
            levels = padded[row + PAD_PX, PAD_PX + first : PAD_PX + after]
            _give_kernel(levels, memory[row, first:after], entry, table[m], limit, portion)


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
        discs: ``(m, 2)`` centres, px; ``(m,)`` how far from them the ground begins, px.
        law: The step, which share of the level up to it is given up, and of what is above.
    """
    (first, every), (center_px, reach_px) = rows, discs
    height, width = memory.shape
    step, below, above = np.float32(law[0]), np.float32(law[1]), np.float32(law[2])
    is_ground = np.empty(width, np.float32)
    for row in range(first, height, every):
        is_ground[:] = 1.0
        for m in range(len(center_px)):
            half = reach_px[m] ** 2 - (row - center_px[m, 1]) ** 2
            if half >= 0.0:
                half = np.sqrt(half)
                left = min(max(int(np.ceil(center_px[m, 0] - half)), 0), width)
                after = max(min(int(np.floor(center_px[m, 0] + half)) + 1, width), left)
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
    padded: NDArray[np.float32],
    memory: NDArray[np.float32],
    discs: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    radius_px: NDArray[np.float64],
    tables: tuple[NDArray[np.float32], NDArray[np.float64]],
    limits: tuple[float, float],
) -> None:  # pragma: no cover - compiled
    """Move the edges of discs at rest towards their calibrated outlines.

    Args:
        padded: The map with its margin of PAD_PX; changed.
        memory: The clipped sums behind it; changed.
        discs: ``(m, 2)`` centres, px; ``(m, 2)`` velocities, px/s; ``(m, 3)`` r, b and c, px.
        radius_px: ``(m,)`` calibrated radii.
        tables: Values and reaches of `profile_tables.ProfileTables`.
        limits: Share of the way that is gone; speed from which a marker does not rest, px/s.
    """
    center_px, velocity_px_s, outline_px = discs
    share, still_px_s = limits
    table, reach_px = tables
    last = table.shape[2] - 1
    height, width = memory.shape
    for m in range(center_px.shape[0]):
        x, y = center_px[m, 0], center_px[m, 1]
        r, b, c = outline_px[m, 0], outline_px[m, 1], outline_px[m, 2]
        as_calibrated = r == radius_px[m] and b == 0.0 and c == 0.0
        if as_calibrated or np.hypot(velocity_px_s[m, 0], velocity_px_s[m, 1]) > still_px_s:
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
