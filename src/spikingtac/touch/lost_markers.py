"""Markers that a tracker has lost, found by their neighbours.

A sudden release can leave a tracker on a wrong place, and a few such markers strain the field more
than a light touch does. An elastic skin moves neighbours alike: a marker that differs from the
median of its neighbourhood by far more than these differ among themselves is not believed.
"""

import numpy as np

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.types import FloatArray as Field

# Markers of a neighbourhood, the marker itself included: the 3 by 3 block of a square grid.
NEIGHBOURS = 9

# Deviation that is always believed, as a share of the markers' pitch (1.1 px of 37 px; good
# trackers err by 0.3 px).
LEAST_PITCH_SHARE = 0.03

# Median deviations of the neighbourhood that are believed (3 rejects markers at the rim of a
# dragged punch on the ten scenes).
SPREAD_FACTOR = 4.0

# Frames between two looks: a lost marker stays lost for long, and the look costs most of it.
EVERY = 5

# Share of the deviation that makes a marker lost below which it is believed again (without it
# markers flicker between the two).
FOUND_SHARE = 0.5


class LostMarkers:
    """Replaces the displacements of missing and of lost markers by those of their neighbours.

    Attributes:
        lost: ``(m,)`` True for the markers that were replaced in the last frame.
    """

    def __init__(self, reference: Field) -> None:
        """Prepare the neighbourhoods of markers ``(m, 2)`` at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        away = np.sqrt(((reference[:, None] - reference[None]) ** 2).sum(axis=2))
        self._near = np.argsort(away, axis=1, kind="stable")[:, :NEIGHBOURS].T
        self._least = LEAST_PITCH_SHARE * marker_pitch_px(reference)
        self.reset()

    def reset(self) -> None:
        """Believe every marker again."""
        self.lost, self._frame = np.zeros(self._near.shape[1], np.bool_), 0

    def filled(self, displacement: Field, rest: Field, before: Field) -> Field:
        """Return displacements ``(m, 2)`` of which none is missing.

        Args:
            displacement: ``(m, 2)``; rows that are not finite are missing.
            rest: ``(m, 2)`` displacements at rest, from which neighbours move alike.
            before: ``(m, 2)`` of the last frame: a marker all of whose neighbours are missing
                stays where it was.
        """
        there = np.isfinite(displacement[:, 0] + displacement[:, 1])
        if there.all():
            return displacement
        filled = np.where(there[:, None], displacement, before)
        for marker in np.flatnonzero(~there):
            near = self._near[:, marker]
            near = near[there[near]]
            if len(near):
                filled[marker] = rest[marker] + np.median(filled[near] - rest[near], axis=0)
        return filled

    def repaired(self, displacement: Field) -> Field:
        """Return displacements ``(m, 2)`` of which the lost ones are replaced."""
        if self._frame % EVERY == 0:
            around = displacement[self._near]
            median = middle_of(around)
            believed = SPREAD_FACTOR * middle_of(np.abs(around - median)) + self._least
            off = (np.abs(displacement - median) / believed).max(axis=1)
            self.lost = off > np.where(self.lost, FOUND_SHARE, 1.0)
        self._frame += 1
        if not self.lost.any():
            return displacement
        out = displacement.copy()
        out[self.lost] = middle_of(displacement[self._near[:, self.lost]])
        return out


def middle_of(values: Field) -> Field:
    """Return the upper median along the first axis."""
    return np.partition(values, len(values) // 2, axis=0)[len(values) // 2]


def spread_of(away: Field, share: float) -> tuple[float, float]:
    """Return the largest displacement, and within which distance of the common one a share lies.

    Args:
        away: ``(m, 2)`` displacements; the common one is their median, axis by axis.
        share: Share of the markers, below 1.
    """
    square, rank = ((away - middle_of(away)) ** 2).sum(axis=1), int(share * len(away))
    largest = float(np.sqrt((away**2).sum(axis=1).max()))
    return largest, float(np.sqrt(np.partition(square, rank)[rank]))
