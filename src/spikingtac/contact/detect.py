"""What a contact detector is: it sees every window, in order, and says when contact begins."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from spikingtac.types import Contact, EventPacket


@runtime_checkable
class ContactDetector(Protocol):
    """Decides on contact from regular windows; it never waits for an image or a network."""

    def update(self, window: EventPacket) -> Contact | None:
        """Take the next window and return a contact where one begins.

        Args:
            window: The events of one period; empty windows are given too, silence is data.
        """
        ...

    def reset(self) -> None:
        """Forget the past windows, not the calibration."""
        ...
