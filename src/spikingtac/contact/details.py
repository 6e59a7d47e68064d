"""What a detector knows about a contact beyond the decision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


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
