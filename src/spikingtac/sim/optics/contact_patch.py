"""Where a body touches the skin and where it sticks, in a form small enough for a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ContactPatch:
    """The cells of the skin that a body touches at one time.

    A cell is a piece of the skin: it is named by its place at rest, not by where the body has
    dragged it. Bits follow ``numpy.packbits`` over the cells in rows, so that
    ``numpy.unpackbits(touching).reshape(n, n)`` is the patch.

    Attributes:
        touching: ``(ceil(n² / 8),)`` one bit per cell, set where any pressure acts.
        sticking: ``(ceil(n² / 8),)`` set where the cell touches and does not slip.
    """

    touching: Bits
    sticking: Bits

    @classmethod
    def of(cls, touching: NDArray[np.bool_], sticking: NDArray[np.bool_]) -> ContactPatch:
        """Pack masks of any equal shape."""
        return cls(np.packbits(touching.ravel()), np.packbits(sticking.ravel()))


NO_PATCH = ContactPatch(np.empty(0, np.uint8), np.empty(0, np.uint8))
"""What a model without cells knows of its patch."""
