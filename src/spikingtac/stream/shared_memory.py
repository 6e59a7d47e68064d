"""Memory that several processes hold: taken as a whole, and given back by its creator alone."""

from __future__ import annotations

import os
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Protocol


class Publisher(Protocol):
    """Takes the latest message; the loop that publishes never waits for it."""

    def publish(self, message: bytes, /) -> bool:
        """Offer a message; False where it was too large and was not taken."""
        ...


def reserve(memory: SharedMemory, size: int) -> None:
    """Take the memory now: a page that is missing later ends the process by a signal."""
    reserve, file = getattr(os, "posix_fallocate", None), getattr(memory, "_fd", -1)
    if reserve is not None and file >= 0:
        reserve(file, 0, size)


def attached(name: str) -> SharedMemory:
    """Open memory of another process; this one's tracker must not remove it at its end."""
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None  # Python 3.13 has an argument for it
    try:
        return SharedMemory(name=name)
    finally:
        resource_tracker.register = register
