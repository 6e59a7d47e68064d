"""Keeps the time of a file's events in order: detours are flattened, restarts are re-based.

A detour leaves the course of time and comes back to it: single wrong timestamps, or a block of
them. A restart falls and does not come back: it goes on from the last event. A leap forward that
does not come back is believed and counted, since a stream may pause.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import JUMP_US, RESET_US
from spikingtac.types import LossCounters

TIME_LIMIT_US = 1 << 60
"""Times and shifts beyond are not believed: 36,000 years, and room for the sum of both."""

HELD_EVENTS = 1 << 12
"""Events off the course that wait for the next chunk, which tells whether time comes back."""

FIRST_EVENTS = 8
"""Up to so many first events are taken for the wrong ones where time falls after them, and so many
times as many follow."""

BREAKS_PER_CHUNK = 1 << 12
"""Breaks of the course that are looked at in one chunk."""

BELIEVED_PER_CHUNK = 16
"""Leaps and restarts that are believed in one chunk; what follows more of them is noise, and time
stands still in it."""

LEAPS_AFTER_RESTART = 64
"""Leaps of one chunk that may take a restart back."""

BREAKS_AHEAD = 1 << 10
"""Breaks ahead among which the end of a detour is looked for."""


class TimeCourse:
    """The course of time through a file, chunk by chunk.

    Args:
        losses: Counters to fill: ``time_glitch``, ``time_backwards``, ``time_reset``,
            ``time_jump``.
    """

    def __init__(self, losses: LossCounters) -> None:
        self._losses = losses
        self._last_us: int | None = None
        self._shift_us = 0
        self._left: tuple[int, int] | None = None

    def mend(self, t: NDArray[np.int64], final: bool) -> tuple[NDArray[np.int64], int]:
        """Return the times in order, and of how many events; the rest waits for the next chunk.

        Args:
            t: Times of the events that waited and of those that follow, us.
            final: Whether nothing follows: no event waits.
        """
        if not len(t):
            return t, 0
        shifted = t + self._shift_us if self._shift_us else t
        last = int(shifted[0]) if self._last_us is None else self._last_us
        steps = np.diff(shifted, prepend=last)
        if steps.min() < 0 or steps.max() >= RESET_US:
            shifted, count = self._mended(shifted.copy(), steps, last, final)
        else:
            count = len(t)
        if count:
            self._last_us = int(shifted[count - 1])
        return shifted[:count], count

    def _mended(
        self, t: NDArray[np.int64], steps: NDArray[np.int64], last: int, final: bool
    ) -> tuple[NDArray[np.int64], int]:
        breaks = _breaks(steps, restarted=self._left is not None)
        leaps = np.setdiff1d(np.flatnonzero(steps >= JUMP_US), breaks, assume_unique=True)
        count = self._follow(t, breaks, last, final) if len(breaks) else len(t)
        self._losses.add("time_jump", int(np.count_nonzero(leaps < count)))
        last = int(t[0]) if self._last_us is None and count else last
        floor = np.maximum.accumulate(np.maximum(t[:count], last))
        self._losses.add("time_backwards", int(np.count_nonzero(floor != t[:count])))
        return floor, count

    def _follow(
        self, t: NDArray[np.int64], breaks: NDArray[np.int64], last: int, final: bool
    ) -> int:
        """Mend the stretches between the breaks, in place; return how many events are settled."""
        edges = np.append(breaks[:BREAKS_PER_CHUNK], len(t))
        first_us = t[edges[:-1]]
        if edges[0]:
            last = max(last, int(t[: edges[0]].max()))
        place = believed = 0
        while place < len(edges) - 1:
            begin, step = int(edges[place]), int(t[edges[place]]) - last
            if -RESET_US < step < RESET_US:
                last = max(last, int(t[begin : edges[place + 1]].max()))
                place += 1
                continue
            wrong_first = self._last_us is None and place == 0 and step < 0 < FIRST_EVENTS - begin
            if wrong_first and FIRST_EVENTS * begin < len(t) - begin:
                t[:begin] = last = int(t[begin])
                self._losses.add("time_glitch", begin)
                continue
            ahead = first_us[place + 1 : place + 1 + BREAKS_AHEAD]
            top = last + JUMP_US if step < 0 else min(last + JUMP_US, last + step - RESET_US)
            back = np.flatnonzero((ahead >= last) & (ahead < top))
            if len(back):
                place += 1 + int(back[0])
                t[begin : edges[place]] = last
                self._losses.add("time_glitch", int(edges[place]) - begin)
                continue
            if not final and len(t) - begin <= HELD_EVENTS:
                return 0 if wrong_first else begin
            believed += 1
            if believed > BELIEVED_PER_CHUNK:
                t[begin:] = last
                self._losses.add("time_glitch", len(t) - begin)
                return len(t)
            shift = self._believed(step, last)
            t[begin:] += shift
            first_us = t[edges[:-1]]
            last = max(last, int(t[begin : edges[place + 1]].max()))
            place += 1
        return len(t)

    def _believed(self, step: int, last: int) -> int:
        """Count a step that does not come back; return by how much what follows is shifted."""
        if step > 0:
            back = self._back(last + step)
            if not back:
                self._losses.add("time_jump", int(step >= JUMP_US))
            self._shift_us += back
            return back
        if self._shift_us - step > TIME_LIMIT_US:
            return 0
        self._left = last, self._shift_us
        self._shift_us -= step
        self._losses.add("time_reset")
        return -step

    def _back(self, time_us: int) -> int:
        """Return the shift that undoes a restart where time is again what it was before it."""
        if self._left is None:
            return 0
        (left_us, shift_us), back = self._left, 0
        if -RESET_US < time_us - self._shift_us + shift_us - left_us < JUMP_US:
            back, self._left = shift_us - self._shift_us, None
        return back


def _breaks(steps: NDArray[np.int64], restarted: bool) -> NDArray[np.int64]:
    """Return the falls, and the leaps that may belong to a detour: near a fall, or at the end.

    Args:
        steps: Step to each event, us.
        restarted: Whether time was re-based before, so that a leap may take it back.
    """
    falls, leaps = np.flatnonzero(steps <= -RESET_US), np.flatnonzero(steps >= RESET_US)
    place = np.searchsorted(falls, leaps)
    before = np.append(falls, -HELD_EVENTS - 1)[place - 1]
    after = np.append(falls, len(steps) + HELD_EVENTS + 1)[place]
    near = (after - leaps <= HELD_EVENTS) | (leaps - before <= HELD_EVENTS)
    near |= (leaps >= len(steps) - HELD_EVENTS) & (steps[leaps] >= JUMP_US)
    first = np.concatenate((leaps[:LEAPS_AFTER_RESTART] if restarted else leaps[:0], falls))
    following = (
        leaps[np.minimum(np.searchsorted(leaps, falls), len(leaps) - 1)] if len(leaps) else leaps
    )
    return np.unique(np.concatenate((first, following, leaps[near])))


TIME_PERIOD_US = 1 << 32
"""Period of a counter of 32 bits, us."""


def unwrapped(t: NDArray[np.int64], epoch_us: int, last: int) -> tuple[NDArray[np.int64], int, int]:
    """Return times beyond the counter, the time at which its present period began, and its value.

    The counter has wrapped where it fell from its last second to its first ones. A wrong timestamp
    near its end falls, too, but nothing led up to it: such steps back and forth cancel.

    Args:
        t: Values of the counter of 32 bits, us.
        epoch_us: Time at which the counter's present period began, us.
        last: The counter's value before them.
    """
    steps = np.diff(t, prepend=last)
    half = TIME_PERIOD_US // 2
    periods = np.cumsum((steps < -half).astype(np.int64) - (steps > half))
    return (
        t + epoch_us + periods * TIME_PERIOD_US,
        epoch_us + int(periods[-1]) * TIME_PERIOD_US,
        int(t[-1]),
    )
