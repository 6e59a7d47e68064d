"""What a contact detector is: it sees every window, in order, and says when contact begins."""

from __future__ import annotations

from typing import Protocol, TypeAlias, runtime_checkable

from spikingtac.types import Contact, EventPacket

Window: TypeAlias = EventPacket | tuple[EventPacket, ...]
"""The events of one period: of one sensor, or one packet per sensor, in the sensors' order."""


@runtime_checkable
class ContactDetector(Protocol):
    """Decides on contact from regular windows; it never waits for an image or a network.

    Attributes:
        in_contact: True from a contact until its end.
    """

    in_contact: bool

    def update(self, window: Window) -> Contact | None:
        """Take the next window and return a contact where one begins.

        Args:
            window: The events of one period; empty windows are given too, silence is data.
        """
        ...

    def reset(self) -> None:
        """Forget the past windows, not the calibration."""
        ...


def packets_of(window: Window) -> tuple[EventPacket, ...]:
    """Return the packets of a window, one per sensor."""
    return window if isinstance(window, tuple) else (window,)


def count_of(window: Window) -> int:
    """Return how many events a window holds, over all sensors."""
    if isinstance(window, tuple):
        return sum(len(packet) for packet in window)
    return len(window)
