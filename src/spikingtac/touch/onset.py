"""When a motion began, from the frames that led to it being noticed and those right after.

A press starts too softly to be seen in one frame of one marker. So the frames are projected on the
pattern that the touch has when it is noticed (a matched filter over all markers), and the rise of
the projection is extrapolated to its rest by its law of growth. What the camera cannot see of a
motion that follows an earlier one is added first.

After a motion every pixel at a marker's edge is closer to its next event in that direction than in
the other, so the first part of a motion the other way makes no event. Each marker is followed by a
point on a short slack string: the string lies along the marker's
last motion.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import FloatArray

# Length of the string, px: motions below it say nothing of a direction (0.1 is alike).
STRING_PX = 0.2

# What an event camera does not see of the beginning of a motion after any earlier one, px, and
# further where the motion reverses the last one, px (with both the begins of 69 touches of the
# ten scenes of the twin are right on the average, 0.0 ms, seeds 3, 4 and 6; a pixel needs an edge
# to move by 0.2 px for one event).
UNSEEN_LATER_PX, UNSEEN_REVERSED_PX = 0.15, 0.25


def unseen_px(string: FloatArray, pattern: FloatArray) -> float:
    """Return how far the skin moves along a pattern ``(m, 2)`` before that is seen, px."""
    strength = (pattern * pattern).sum(axis=1)
    total = float(strength.sum())
    if total <= 0.0:
        return 0.0
    weight = strength / total
    moved = np.sqrt((string * string).sum(axis=1)) / STRING_PX
    along = (string * pattern).sum(axis=1) / np.sqrt(np.maximum(strength, 1e-12)) / STRING_PX
    reversal = max(0.0, -float(weight @ along))
    return UNSEEN_LATER_PX * float(weight @ moved) + UNSEEN_REVERSED_PX * reversal


# Frames that are remembered before a touch is noticed, us (presses of the ten scenes are
# noticed after 15 to 70 ms).
HISTORY_US = 400_000

BASE_US = 100_000  # Span of rest whose median is the level from which the motion rises, us.

# Shares of the pattern between which the rise is fitted (up to 1.0 and from 0.3 to 2.0 err
# more on the ten scenes).
FIRST_SHARE, LAST_SHARE = 0.2, 1.5

# Share of its height up to which a rise that ends below ``LAST_SHARE`` is fitted (0.8 and
# 0.9 err about as much).
RISING_SHARE = 0.85
LATER_US = 80_000  # Time after the touch is noticed within which the rise is fitted, us.

# Power of time with which a press is taken to set in (a sphere at constant speed has 1.5 by
# Hertz; 1.5 to 1.9 in the truth of the ten scenes).
GROWTH_POWER = 1.85
LEAST_ROWS = 3  # Fewer frames in the rise are not fitted: frames of a slow camera.


class OnsetMemory:
    """The last frames, in bounded memory, and the search for a beginning in them."""

    def __init__(self, markers: int, sees_changes: bool) -> None:
        """Start with markers that never moved; ``sees_changes`` of an event camera."""
        self._sees_changes = sees_changes
        self._followed = np.zeros((markers, 2))  # The strings' ends.
        self._frames: deque[tuple[int, FloatArray, FloatArray]] = deque()
        self._noticed_us: int | None = None
        self._pattern = np.zeros((0, 2))

    def clear(self) -> None:
        """Forget every frame."""
        self._frames.clear()
        self._noticed_us = None

    def _string(self, displacement: FloatArray) -> FloatArray:
        """Return the strings ``(m, 2)`` of the next frame, px: each along the last motion."""
        away = displacement - self._followed
        length = np.sqrt((away * away).sum(axis=1, keepdims=True))
        string = away * np.minimum(STRING_PX / np.maximum(length, STRING_PX), 1.0)
        self._followed = displacement - string
        return string

    def add(self, t_us: int, displacement: FloatArray) -> None:
        """Remember a frame ``(m, 2)`` and forget those too old."""
        self._frames.append((t_us, displacement, self._string(displacement)))
        while self._frames and t_us - self._frames[0][0] > HISTORY_US:
            self._frames.popleft()

    def notice(self, pattern: FloatArray) -> int:
        """Take the last frame's pattern ``(m, 2)`` for a touch; return when it began, us."""
        self._noticed_us, self._pattern = self._frames[-1][0], pattern
        return self._begin_us()

    def refine(self, t_us: int, displacement: FloatArray) -> int | None:
        """Take in a frame after the notice; return a better beginning once the rise is done."""
        string = self._string(displacement)
        if self._noticed_us is None:
            return None
        self._frames.append((t_us, displacement, string))
        noticed = next(field for at_us, field, _ in self._frames if at_us == self._noticed_us)
        risen = float(((displacement - noticed) * self._pattern).sum())
        strength = float((self._pattern**2).sum())
        if risen < (LAST_SHARE - 1.0) * strength and t_us - self._noticed_us < LATER_US:
            return None
        begin_us = self._begin_us()
        self.clear()
        return begin_us

    def _begin_us(self) -> int:
        times = np.array([t for t, _, _ in self._frames], np.int64)
        fields = np.array([field for _, field, _ in self._frames]).reshape(len(times), -1)
        along = fields @ self._pattern.ravel() / max(float((self._pattern**2).sum()), 1e-12)
        noticed = int(np.searchsorted(times, self._noticed_us or 0))
        along = along - along[noticed] + 1.0
        # The rise sets in where it lies farthest below its chord, whatever crept before.
        chord = np.interp(times, times[[0, -1]], along[[0, -1]])
        last = int((along - chord)[: noticed + 1].argmin())
        rest = slice(np.searchsorted(times, times[last] - BASE_US), last + 1)
        unseen = unseen_px(self._frames[last][2], self._pattern) if self._sees_changes else 0.0
        largest = float(np.sqrt((self._pattern**2).sum(axis=1).max()))
        above = along - float(np.median(along[rest]))
        return _extrapolated(times, above, last, unseen / max(largest, 1e-9))


def _extrapolated(times: NDArray[np.int64], above: FloatArray, last: int, unseen: float) -> int:
    """Return where the rise after the row ``last`` meets its rest, by its law of growth.

    Args:
        times: ``(n,)`` us.
        above: ``(n,)`` the rise over its rest, in patterns.
        last: Last row before the rise.
        unseen: What the camera has not seen of it, in patterns.
    """
    end = np.flatnonzero(above > LAST_SHARE)
    if not len(end):  # it has come to a stand: where it stands it rises no more
        end = np.flatnonzero(above > RISING_SHARE * float(above[last:].max()))
    rows = np.arange(last + 1, int(end[0]) + 1 if len(end) else len(times))
    rows = rows[above[rows] > FIRST_SHARE]
    if len(rows) < LEAST_ROWS:
        return int(times[last])
    root = (above[rows] + unseen) ** (1.0 / GROWTH_POWER)
    elapsed = (times[rows] - times[last]).astype(np.float64)
    slope = float(np.cov(elapsed, root, ddof=0)[0, 1]) / float(elapsed.var())
    if slope <= 0.0:
        return int(times[last])
    begin_us = float(elapsed.mean()) - float(root.mean()) / slope
    return max(int(times[last]) + round(begin_us), int(times[0]))
