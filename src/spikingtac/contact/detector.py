"""The protocol of a contact detector: it takes every window in order and reports contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from spikingtac.contact.details import ContactDetails
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.contact.window import Window
from spikingtac.types import Contact


@dataclass(frozen=True, kw_only=True)
class DetectorSummary:
    """What a detector was built from, and when it reports a contact.

    Attributes:
        rule: The decision rule with its threshold, one sentence for people.
        quiet: Event counts of the quiet windows that the detector learned from; None where it was
            given its threshold or has not learned yet.
        figures: The detector's own figures by name, as JSON can hold them.
    """

    rule: str
    quiet: QuietStatistics | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)


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
            window: The events of one period. Empty windows are given too: silence is data.
        """
        ...

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        ...

    def details(self) -> ContactDetails | None:
        """Return onset and place of the present contact.

        Returns:
            None where there is no contact, or where the detector does not know more about it.
        """
        ...

    def summary(self) -> DetectorSummary:
        """Return what the detector was built from, and its decision rule."""
        ...
