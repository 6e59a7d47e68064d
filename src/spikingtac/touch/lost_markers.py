"""Markers that a tracker has lost, found by their neighbours.

A sudden release can leave a tracker on a wrong place, and a few such markers strain the field more
than a light touch does. An elastic skin moves neighbours alike: a marker that differs from the
median of its neighbourhood by far more than these differ among themselves is not believed.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

# Markers of a neighbourhood, the marker itself included: the 3 by 3 block of a square grid.
NEIGHBOURS = 9

# Deviation that is always believed, as a share of the markers' pitch (ours: 1.1 px of 37 px; good
# trackers err by 0.3 px).
LEAST_PITCH_SHARE = 0.03

# Median deviations of the neighbourhood that are believed (ours: 3 rejects markers at the rim of
# a dragged punch on the ten scenes).
SPREAD_FACTOR = 4.0


# Frames between two looks: a lost marker stays lost for long, and the look costs most of it.
EVERY = 5

# Share of the deviation that makes a marker lost below which it is believed again (ours: without
# it markers flicker between the two).
FOUND_SHARE = 0.5


class LostMarkers:
    """Replaces the displacements of lost markers by the median of their neighbourhoods.

    Attributes:
        lost: ``(m,)`` True for the markers that were replaced in the last frame.
    """

    def __init__(self, reference: Field) -> None:
        """Prepare the neighbourhoods of markers ``(m, 2)`` at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        away = np.sqrt(((reference[:, None] - reference[None]) ** 2).sum(axis=2))
        near = min(NEIGHBOURS, len(reference))
        self._near = np.argsort(away, axis=1, kind="stable")[:, :near].T.copy()
        self.lost, self._some_lost = np.zeros(len(reference), np.bool_), False
        self._frame = 0
        self._least = LEAST_PITCH_SHARE * marker_pitch_px(reference)

    def repaired(self, displacement: Field) -> Field:
        """Return displacements ``(m, 2)`` of which the lost ones are replaced."""
        if self._frame % EVERY == 0:
            self._look(displacement)
        self._frame += 1
        if not self._some_lost:
            return displacement
        out = np.array(displacement, np.float64)
        repair_kernel(np.ascontiguousarray(displacement, np.float64), self._near, self.lost, out)
        return out

    def _look(self, displacement: Field) -> None:
        off = np.empty(len(displacement))
        moved = np.ascontiguousarray(displacement, np.float64)
        deviation_kernel(moved, self._near, SPREAD_FACTOR, self._least, off)
        self.lost = off > np.where(self.lost, FOUND_SHARE, 1.0)
        self._some_lost = bool(self.lost.any())

    def reset(self) -> None:
        """Believe every marker again."""
        self.lost, self._some_lost = np.zeros_like(self.lost), False
        self._frame = 0


@njit(cache=True, nogil=True)
def deviation_kernel(
    displacement: Field, near: NDArray[np.int64], factor: float, least: float, off: Field
) -> None:
    """Fill how far each marker is from its neighbourhood, over the largest plausible distance.

    Args:
        displacement: ``(m, 2)``.
        near: ``(n, m)`` the markers of each neighbourhood.
        factor: Median deviations that are believed.
        least: Deviation that is always believed.
        off: ``(m,)`` overwritten.
    """
    values, middle = np.empty(len(near)), len(near) // 2
    for marker in range(len(off)):
        off[marker] = 0.0
        for axis in range(2):
            for k in range(len(near)):
                values[k] = displacement[near[k, marker], axis]
            median = select_kernel(values, middle)
            for k in range(len(near)):
                values[k] = abs(displacement[near[k, marker], axis] - median)
            believed = factor * select_kernel(values, middle) + least
            off[marker] = max(off[marker], abs(displacement[marker, axis] - median) / believed)


@njit(cache=True, nogil=True)
def repair_kernel(
    displacement: Field, near: NDArray[np.int64], lost: NDArray[np.bool_], out: Field
) -> None:
    """Replace lost markers by the median of their neighbourhoods, axis by axis.

    Args:
        displacement: ``(m, 2)``.
        near: ``(n, m)`` the markers of each neighbourhood.
        lost: ``(m,)``.
        out: ``(m, 2)`` rows of lost markers overwritten.
    """
    values, middle = np.empty(len(near)), len(near) // 2
    for marker in range(len(lost)):
        if not lost[marker]:
            continue
        for axis in range(displacement.shape[1]):
            for k in range(len(near)):
                values[k] = displacement[near[k, marker], axis]
            out[marker, axis] = select_kernel(values, middle)


@njit(cache=True, nogil=True)
def select_kernel(values: Field, rank: int) -> float:
    """Return the value of a rank, 0 for the smallest, by Hoare's selection.

    The values are reordered; doi 10.1145/366622.366647. (``np.partition`` gives the same, and takes
    seconds to compile.)
    """
    first, last = 0, len(values) - 1
    while first < last:
        pivot, i, j = values[(first + last) // 2], first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            last = j
        elif rank >= i:
            first = i
        else:
            break
    return values[rank]


class AbsentMarkers:
    """Lets markers without a place, whose numbers are not finite, move as their neighbours do."""

    def __init__(self, reference: Field) -> None:
        """Prepare the neighbourhoods of markers ``(m, 2)`` at rest."""
        away = ((reference[:, None] - reference[None]) ** 2).sum(axis=2)
        self._near = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBOURS]

    def filled(self, displacement: Field, rest: Field, before: Field) -> Field:
        """Return displacements ``(m, 2)`` of which none is missing.

        Args:
            displacement: ``(m, 2)``; rows that are not finite are missing.
            rest: ``(m, 2)`` displacements at rest, from which neighbours move alike.
            before: ``(m, 2)`` of the last frame: a marker all of whose neighbours are missing
                stays where it was.
        """
        finite = np.isfinite(displacement)
        if finite.all():
            return displacement
        there = finite[:, 0] & finite[:, 1]
        filled = np.where(there[:, None], displacement, before)
        for marker in np.flatnonzero(~there):
            near = self._near[marker][there[self._near[marker]]]
            if len(near):
                filled[marker] = rest[marker] + np.median(filled[near] - rest[near], axis=0)
        return filled


@njit(cache=True, nogil=True)
def spread_kernel(away: Field, share: float) -> tuple[float, float]:
    """Return the largest displacement, and within which distance of the common one a share lies.

    Args:
        away: ``(m, 2)`` displacements; the common one is their median, axis by axis.
        share: Share of the markers, below 1.
    """
    markers = len(away)
    distance, largest = np.empty(markers), 0.0
    for marker in range(markers):
        distance[marker] = away[marker, 0]
    x = select_kernel(distance, markers // 2)
    for marker in range(markers):
        distance[marker] = away[marker, 1]
    y = select_kernel(distance, markers // 2)
    for marker in range(markers):
        largest = max(largest, away[marker, 0] ** 2 + away[marker, 1] ** 2)
        distance[marker] = (away[marker, 0] - x) ** 2 + (away[marker, 1] - y) ** 2
    return np.sqrt(largest), np.sqrt(select_kernel(distance, int(share * markers)))
