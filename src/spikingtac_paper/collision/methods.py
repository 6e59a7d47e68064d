"""The methods of the collision experiment: all contact detectors, and the baselines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spikingtac.contact.registry import DETECTORS
from spikingtac_paper.baselines.frame_sampling import FrameSamplingConfig

Sees = Literal["events", "frames", "touch"]

PUBLISHED = "event_count"
"""The detector that the paper describes; the report compares its numbers with this one's."""
SAMPLED, PLUS_ONE, PAPER_DELAY, PERFECT = (
    "frame_sampling", "frame_plus_one", "frame_paper", "zero_delay",
)  # fmt: skip
PAPER_DELAY_US = 135_000.0
"""The paper's largest deviation of its frame baseline, 24.3 mm at 0.18 m/s, is 135 ms."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CollisionMethod:
    """One way to decide on contact.

    Attributes:
        name: Name in the report.
        about: One line about it.
        sees: ``events`` (the detector of that name), ``frames``, or the true first ``touch``.
        delay_us: Delay that is added to its decision, us.
    """

    name: str
    about: str
    sees: Sees
    delay_us: float = 0.0


ABOUT = {
    PUBLISHED: "as published: events of 1 ms above a threshold, taken from the moving arm",
    "default": "sequential test of the signed rim events over nine time scales",
}


def collision_methods() -> dict[str, CollisionMethod]:
    """Return the methods by name: the registered detectors first."""
    frame_us = FrameSamplingConfig().period_us
    baselines = (
        CollisionMethod(
            name=SAMPLED, sees="frames",
            about="displacement sum over the markers at 32 fps, no other latency",
        ),
        CollisionMethod(
            name=PLUS_ONE, sees="frames", delay_us=frame_us,
            about="the same with one more frame of latency",
        ),
        CollisionMethod(
            name=PAPER_DELAY, sees="touch", delay_us=PAPER_DELAY_US,
            about="135 ms after the touch: the paper's baseline, its undocumented latency included",
        ),
        CollisionMethod(
            name=PERFECT, sees="touch",
            about="a perfect sensor: decides at the true first touch, on the same arm",
        ),
    )  # fmt: skip
    detectors = [
        CollisionMethod(name=name, sees="events", about=ABOUT.get(name, "a contact detector"))
        for name in DETECTORS
    ]
    return {method.name: method for method in (*detectors, *baselines)}
