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

# Times and shifts beyond are not believed: 36,000 years, and room for the sum of both.
TIME_LIMIT_US = 1 << 60

# Events off the course that wait for the next chunk, which tells whether time comes back.
HELD_EVENTS = 1 << 12

# Up to so many first events are taken for the wrong ones where time falls after them, and so many
# times as many follow.
FIRST_EVENTS = 8

# Leaps and restarts that are believed in one chunk; what follows more of them is noise, and time
# stands still in it.
BELIEVED_PER_CHUNK = 16


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
        count = self._follow(t, steps, last, final)
        last = int(t[0]) if self._last_us is None and count else last
        floor = np.maximum.accumulate(np.maximum(t[:count], last))
        self._losses.add("time_backwards", int(np.count_nonzero(floor != t[:count])))
        return floor, count

    def _follow(
        self, t: NDArray[np.int64], steps: NDArray[np.int64], last: int, final: bool
    ) -> int:
        """Mend the times where they fall or leap, in place; return how many events are settled."""
        falls = np.flatnonzero(steps <= -RESET_US)
        place = believed = 0
        for begin in np.flatnonzero(abs(steps) >= RESET_US).tolist():
            if begin < place:
                continue
            last = int(t[place:begin].max(initial=last))
            place, step = begin, int(t[begin]) - last
            ahead = t[begin + 1 : begin + 1 + HELD_EVENTS]
            settled = final or len(ahead) == HELD_EVENTS
            before, within = np.searchsorted(falls, (begin, begin + HELD_EVENTS), side="right")
            if abs(step) < RESET_US:
                continue
            if step > 0 and before == within and (settled or step < JUMP_US):
                t[begin:] += self._believed(step, last)
                continue
            wrong_first = self._last_us is None and step < 0 < begin < FIRST_EVENTS
            if wrong_first and FIRST_EVENTS * begin < len(t) - begin:
                t[:begin] = last = int(t[begin])
                self._losses.add("time_glitch", begin)
                continue
            top = last + JUMP_US if step < 0 else min(last + JUMP_US, last + step - RESET_US)
            back = np.flatnonzero((ahead >= last) & (ahead < top))
            if len(back):
                place = begin + 1 + int(back[0])
                t[begin:place] = last
                self._losses.add("time_glitch", place - begin)
                continue
            if not settled:
                return 0 if wrong_first else begin
            believed += 1
            if believed > BELIEVED_PER_CHUNK:
                t[begin:] = last
                self._losses.add("time_glitch", len(t) - begin)
                break
            t[begin:] += self._believed(step, last)
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


TIME_PERIOD_US = 1 << 32  # Period of a counter of 32 bits, us.


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
