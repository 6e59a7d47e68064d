"""Windows of events, and the protocol of what decides on contact from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

from spikingtac.types import Contact, EventPacket

if TYPE_CHECKING:
    from spikingtac.contact.quiet import QuietStatistics

WINDOW_US = 1_000  # Raw events are counted in windows of 1 ms (paper section V-B).

# The events of one period: of one sensor, or one packet per sensor, in the sensors' order.
Window: TypeAlias = EventPacket | tuple[EventPacket, ...]


def packets_of(window: Window) -> tuple[EventPacket, ...]:
    """Return the packets of a window, one per sensor."""
    return window if isinstance(window, tuple) else (window,)


def count_of(window: Window) -> int:
    """Return how many events a window holds, over all sensors."""
    if isinstance(window, tuple):
        return sum(len(packet) for packet in window)
    return len(window)


@dataclass(frozen=True, slots=True)
class GelTouch:
    """A contact as one sensor saw it.

    Attributes:
        place_px: ``(x, y)`` centroid of the displaced markers, weighted by their evidence, px.
        push: ``(x, y)`` mean direction of their motion, in image axes. Its length is 1 where all
            markers moved alike, and near 0 where they turned about their centroid.
        turn: -1 to 1: how far the motion is a rotation about the centroid, positive from x to y
            (clockwise as displayed).
        markers: How many markers moved.
    """

    place_px: tuple[float, float]
    push: tuple[float, float]
    turn: float
    markers: int

    def as_mapping(self) -> dict[str, Any]:
        """Return the fields, rounded to 0.1 px and 0.001, as JSON can hold them."""
        return {
            "place_px": [round(value, 1) for value in self.place_px],
            "push": [round(value, 3) for value in self.push],
            "turn": round(self.turn, 3),
            "markers": self.markers,
        }


@dataclass(frozen=True, slots=True)
class ContactDetails:
    """What is known about a contact beyond the decision.

    Attributes:
        onset_us: The most likely time at which the motion began, us.
        touches: One entry per sensor; None for a sensor whose markers did not move.
    """

    onset_us: int
    touches: tuple[GelTouch | None, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Return ``onset_us`` and ``sensors``, as JSON can hold them."""
        return {
            "onset_us": self.onset_us,
            "sensors": [touch.as_mapping() if touch else None for touch in self.touches],
        }


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
