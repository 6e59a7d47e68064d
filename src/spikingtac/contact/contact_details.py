"""Where a contact shows on the gel, which way it pushes, and when it began.

None of this is needed to stop: it is worked out after the decision, from what the detector kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

MOVED_RATIO = 5.0
"""A marker moved where its squared votes exceed those of noise so many times (exponentially
distributed: 1 in 150 by chance)."""


@dataclass(frozen=True, slots=True)
class GelTouch:
    """What one sensor saw of a contact.

    Attributes:
        place_px: ``(x, y)`` centroid of the displaced markers, weighted by their votes, px.
        push: ``(x, y)`` their mean direction, in image axes; its length is 1 where all moved
            alike, and near 0 where they turned about their centroid.
        turn: -1 to 1: how far the motion is a rotation about the centroid, positive from x to y
            (clockwise as displayed).
        markers: How many markers moved.
    """

    place_px: tuple[float, float]
    push: tuple[float, float]
    turn: float
    markers: int


@dataclass(frozen=True, slots=True)
class ContactDetails:
    """What is known about a contact beyond the decision.

    Attributes:
        onset_us: When the motion began, us: the likeliest time of change.
        touches: Of each sensor; None for one whose markers did not move.
    """

    onset_us: int
    touches: tuple[GelTouch | None, ...]


def gel_touch(votes: Vector, center_px: Vector, noise: float) -> GelTouch | None:
    """Return what the markers' votes since the onset say, or None where they say nothing.

    Args:
        votes: ``(m, 2)`` sum of each marker's votes.
        center_px: ``(m, 2)`` the markers.
        noise: Expected squared length of a marker's votes without contact.
    """
    power = (votes**2).sum(axis=1)
    weight = np.maximum(power - MOVED_RATIO * noise, 0.0)
    moved = weight > 0.0
    if not moved.any():
        return None
    share = weight / weight.sum()
    place = share @ center_px
    unit = votes / np.sqrt(np.maximum(power, np.finfo(float).tiny))[:, None]
    away = center_px - place
    arm = share @ np.hypot(away[:, 0], away[:, 1])
    moment = share @ (away[:, 0] * unit[:, 1] - away[:, 1] * unit[:, 0])
    push = share @ unit
    return GelTouch(
        place_px=(float(place[0]), float(place[1])),
        push=(float(push[0]), float(push[1])),
        turn=float(moment / arm) if arm > 0.0 else 0.0,
        markers=int(moved.sum()),
    )


def likeliest_onset(progress: Vector) -> int:
    """Return after how many windows a drift began that lasts to the end.

    For Gaussian sums the likeliest time of change is where the running sum, less the drift of pure
    chance, is lowest (Page, Biometrika 41, 1954); the reference drift is half the mean one since.

    Args:
        progress: ``(n + 1,)`` running sum along the contact's direction, from 0 windows on.
    """
    lowest = int(progress.argmin())
    slope = (progress[-1] - progress[lowest]) / max(len(progress) - 1 - lowest, 1)
    return int((progress - 0.5 * slope * np.arange(len(progress))).argmin())
