"""How well two ways of tracking the same moments agree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from spikingtac.tracks import Tracks
from spikingtac.types import MarkerFrame

MEAN_TOLERANCE_PX = 0.3
"""Largest mean distance of the markers at a seam, px (ours: 0.18 px is usual after an overlap of
2 s, 0.25 px the most of 26 cuts; both ways are off the truth by 0.15 px)."""
WORST_TOLERANCE_PX = 1.5
"""Largest distance of any marker, px: more is a marker that one way has lost."""
SETTLED_US = 1_000_000
"""How long a piece that is tracked again must agree before the first way is taken up again, us."""


@dataclass(frozen=True, slots=True)
class Distance:
    """Distance of two ways of tracking the same moments.

    Attributes:
        mean_px: Mean over markers and times, px.
        worst_px: The largest mean over time of any marker, px.
    """

    mean_px: float
    worst_px: float

    @property
    def small(self) -> bool:
        """Whether both ways agree."""
        return self.mean_px <= MEAN_TOLERANCE_PX and self.worst_px <= WORST_TOLERANCE_PX


def distance(before: Tracks, after: Tracks) -> Distance:
    """Return how far two tracks are apart at the times that both have, both coasted left out.

    Tracks without a common time agree: nothing contradicts them.
    """
    _, one, other = np.intersect1d(before.t_us, after.t_us, return_indices=True)
    if not len(one):
        return Distance(0.0, 0.0)
    moved_px = before.detected_px[one].astype(np.float64) - after.detected_px[other]
    apart_px = np.hypot(moved_px[..., 0], moved_px[..., 1])
    both_lost = (before.coasted[one] & after.coasted[other]).all(axis=0)
    each_px = np.where(both_lost, 0.0, apart_px.mean(axis=0))
    return Distance(float(each_px.mean()), float(each_px.max(initial=0.0)))


class Agreement:
    """Compares frames with tracks of the same times, until they have agreed for long enough.

    Args:
        tracks: What is compared with.

    Attributes:
        agreed_us: Since when they agree, where :meth:`until` has ended for that; None before.
    """

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self.agreed_us: int | None = None

    def until(self, frames: Iterable[MarkerFrame]) -> Iterator[MarkerFrame]:
        """Yield frames up to where the tracks can be taken up."""
        since_us: int | None = None
        for frame in frames:
            apart_px = self._apart_px(frame)
            if apart_px is None or not apart_px.small:
                since_us = None
            elif since_us is None:
                since_us = frame.t_us
            elif frame.t_us >= since_us + SETTLED_US:
                self.agreed_us = frame.t_us
                return
            yield frame

    def _apart_px(self, frame: MarkerFrame) -> Distance | None:
        row = int(self._tracks.t_us.searchsorted(frame.t_us))
        if row == len(self._tracks.t_us) or self._tracks.t_us[row] != frame.t_us:
            return None
        moved_px = frame.detected_px - self._tracks.detected_px[row]
        each_px = np.hypot(moved_px[:, 0], moved_px[:, 1])
        each_px[frame.coasted & self._tracks.coasted[row]] = 0.0
        return Distance(float(each_px.mean()), float(each_px.max(initial=0.0)))
