"""The protocol of every state map: the paper's binary one and the graded one."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket


class StateMap(Protocol):
    """A persistent image of the skin that events keep up to date."""

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` from 0 (ground) to 1 (marker); a view, to be read and not kept."""
        ...

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time."""
        ...

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        ...
