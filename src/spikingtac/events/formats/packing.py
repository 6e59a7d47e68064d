"""Turns the columns of any file into sound packets, with their times in order.

A detour leaves the course of time and comes back to it: single wrong timestamps, or a block of
them. A restart falls and does not come back: it goes on from the last event. A leap forward that
does not come back is believed and counted, since a stream may pause.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.codec import JUMP_US, RESET_US
from spikingtac.types import EventPacket, LossCounters

# Columns x, y, p and t of some consecutive events, and those of no event.
Rows = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]
NO_ROWS: Rows = tuple(np.empty(0, kind) for kind in ("u2", "u2", "?", "i8"))  # type: ignore

# Times and shifts beyond are not believed: 36,000 years, and room for the sum of both.
TIME_LIMIT_US = 1 << 60

# Events off the course that wait for the next chunk, which tells whether time comes back.
HELD_EVENTS = 1 << 12

# Up to so many first events are taken for the wrong ones where time falls after them, and so many
# times as many follow.
FIRST_EVENTS = 8

FILL_EVENTS = 32  # No sensor sends more events of one pixel in one microsecond.

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
        steps, count = np.diff(shifted, prepend=last), len(t)
        if steps.min() < 0 or steps.max() >= RESET_US:
            shifted = shifted.copy()
            count = self._follow(shifted, steps, last, final)
            last = int(shifted[0]) if self._last_us is None and count else last
            mended, shifted = shifted[:count], np.maximum.accumulate(shifted[:count].clip(min=last))
            self._losses.add("time_backwards", int(np.count_nonzero(mended != shifted)))
        if count:
            self._last_us = int(shifted[count - 1])
        return shifted[:count], count

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
            back, (left_us, shift_us) = 0, self._left or (TIME_LIMIT_US, self._shift_us)
            # A restart is undone where time is again what it was before it.
            if -RESET_US < last + step - self._shift_us + shift_us - left_us < JUMP_US:
                back, self._left = shift_us - self._shift_us, None
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


def chosen_rows(rows: Rows, keep: Any) -> Rows:
    """Return the rows that a mask, an index array or a slice keeps."""
    x, y, p, t = (column[keep] for column in rows)
    return x, y, p, t


def finite_rows(rows: Rows, losses: LossCounters) -> Rows:
    """Return the rows without those that hold "not a number" or infinity, which are counted."""
    floats = [column for column in rows if column.dtype.kind == "f"]
    sound = np.isfinite(floats).all(axis=0) if floats else np.True_
    if sound.all():
        return rows
    losses.add("bad_record", int(np.count_nonzero(~sound)))
    return chosen_rows(rows, sound)


class ColumnCheck:
    """Drops what is outside of the sensor and keeps time monotonic.

    Args:
        size: ``(width, height)`` of the sensor, px.
        losses: Counters to fill.
    """

    def __init__(self, size: tuple[int, int], losses: LossCounters) -> None:
        self._width, self._height = size
        self._losses = losses
        self._course = TimeCourse(losses)
        self._held = NO_ROWS

    def __call__(self, x: NDArray[Any], y: NDArray[Any], p: NDArray[Any], t: NDArray[Any]) -> Rows:
        """Return sound columns; the last events may wait for the next call (see TimeCourse)."""
        x, y, p, t = finite_rows((x, y, p, t), self._losses)
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < self._height)
        if not inside.all():
            self._losses.add("out_of_range", int(len(inside) - np.count_nonzero(inside)))
            x, y, p, t = chosen_rows((x, y, p, t), inside)
        x, y, p, t = _without_fill((x, y, p, t), self._losses)
        on = p if p.dtype == np.bool_ else p > 0
        columns = x.astype(np.uint16), y.astype(np.uint16), on, _whole(t)
        if len(self._held[0]):
            x, y, p, t = map(np.concatenate, zip(self._held, columns, strict=True))
            columns = x, y, p, t
        return self._mended(columns, final=False)

    def finish(self) -> Rows:
        """Return the events that still wait."""
        return self._mended(self._held, final=True)

    def _mended(self, columns: Rows, final: bool) -> Rows:
        time, count = self._course.mend(columns[3], final)
        self._held = chosen_rows(columns, slice(count, None))
        return *chosen_rows(columns, slice(count))[:3], time


def _without_fill(rows: Rows, losses: LossCounters) -> Rows:
    """Return the rows without stretches of one and the same event, as a lost sector reads."""
    same = np.all([column[1:] == column[:-1] for column in rows], axis=0)
    if np.count_nonzero(same) < FILL_EVENTS:
        return rows
    lengths = np.diff(np.flatnonzero(np.append(True, ~same)), append=len(same) + 1)
    losses.add("garbage", int(np.count_nonzero(lengths > FILL_EVENTS)))
    return chosen_rows(rows, np.repeat(lengths <= FILL_EVENTS, lengths))


def _whole(t: NDArray[Any]) -> NDArray[np.int64]:
    """Return times as whole microseconds within the limits (a copy where they were not)."""
    if t.dtype.kind == "f":
        t = np.rint(t)
    if t.dtype.kind == "u":
        t = np.minimum(t, np.uint64(TIME_LIMIT_US))
    return np.clip(t, -TIME_LIMIT_US, TIME_LIMIT_US).astype(np.int64)


class Counter:
    """A device's counter of time, which begins anew after a period.

    It has begun anew where two times of its last sixteenth are followed by two of its first one: a
    single time may be wrong. Where it seems to fall back so by wrong times, such steps cancel.

    Args:
        period: How far it counts.
    """

    def __init__(self, period: int) -> None:
        self._period, self._begun, self._last = period, 0, None

    def unwrapped(self, t: NDArray[Any]) -> NDArray[np.int64]:
        """Return ``(n,)`` times that follow the ones before, without the falls."""
        if not len(t):
            return t.astype(np.int64)
        near = self._period // 16
        place = np.append(int(t[0]) if self._last is None else self._last, t.astype(np.int64))
        first, last = place < near, place >= self._period - near
        of_two = [zone & np.append(True, zone[:-1]) for zone in (last, first)]
        by_two = [zone & np.append(zone[1:], True) for zone in (first, last)]
        ahead, back = (of[:-1] & by[1:] for of, by in zip(of_two, by_two, strict=True))
        periods = np.cumsum(ahead.astype(np.int64) - back) + self._begun
        self._last, self._begun = int(t[-1]), int(periods[-1])
        return t + periods * self._period


TIE_LIMIT = 1 << 22  # Events of one and the same microsecond that are held back at most.


class Packer:
    """Checks columns once, where data enters, and cuts them into packets.

    Events of the last microsecond wait for the next piece, since more of them may follow: a packet
    ends before the next one begins.

    Args:
        size: ``(width, height)`` of the sensor, px.
        chunk_events: About how many events a packet holds.
    """

    def __init__(self, size: tuple[int, int], chunk_events: int) -> None:
        self._size = size
        self._chunk_events = chunk_events
        self._held = EventPacket.empty(0, 0, size)
        self._start_us: int | None = None

    def push(
        self, x: NDArray[Any], y: NDArray[Any], p: NDArray[Any], t: NDArray[Any]
    ) -> Iterator[EventPacket]:
        """Take (and copy) columns in order of time and on the sensor; yield what is complete."""
        if not len(t):
            return
        if self._start_us is None:
            self._start_us = int(t[0])
        if t[0] < self._start_us:
            t = np.maximum(t, self._start_us)
        whole = EventPacket(x, y, p, t, self._start_us, int(t[-1]), self._size, True)
        # Joining copies, also where nothing is held: the columns may be buffers of a decoder.
        whole = EventPacket.concatenate([self._held, whole])
        complete = int(np.searchsorted(whole.t, whole.t[-1]))
        if len(whole) - complete > TIE_LIMIT:
            complete = len(whole)
        if complete:
            end_us = int(whole.t[complete - 1]) + 1 if complete == len(whole) else int(whole.t[-1])
            yield from self._slices(whole.part(0, complete, self._start_us, end_us))
            self._start_us = end_us
        self._held = whole.part(complete, len(whole), self._start_us, self._start_us)

    def finish(self) -> Iterator[EventPacket]:
        """Yield the events of the last microsecond."""
        if len(self._held) and self._start_us is not None:
            last_us = int(self._held.t[-1]) + 1
            yield from self._slices(self._held.part(0, len(self._held), self._start_us, last_us))
            self._start_us = last_us
            self._held = EventPacket.empty(0, 0, self._size)

    def _slices(self, packet: EventPacket) -> Iterator[EventPacket]:
        first, start_us = 0, packet.t_start_us
        while len(packet) - first > self._chunk_events:
            cut = int(np.searchsorted(packet.t, packet.t[first + self._chunk_events]))
            if cut <= first:
                cut = int(np.searchsorted(packet.t, packet.t[first], side="right"))
            if cut >= len(packet):
                break
            end_us = int(packet.t[cut])
            yield packet.part(first, cut, start_us, end_us)
            first, start_us = cut, end_us
        yield packet.part(first, len(packet), start_us, packet.t_end_us)
