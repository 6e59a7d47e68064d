"""Markers without a place in a frame: what is taken for their motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.lost_markers import NEIGHBOURS

Field = NDArray[np.float64]


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
