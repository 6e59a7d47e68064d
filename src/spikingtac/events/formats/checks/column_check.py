"""Mends the columns of any file: what is off the sensor goes, time stays in order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.formats.checks.time_course import TIME_LIMIT_US, TimeCourse
from spikingtac.types import LossCounters

Sound = tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_], NDArray[np.int64]]
"""Columns x, y, p and t of the package's types."""


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
        self._held: Sound = _none()

    def __call__(self, x: NDArray[Any], y: NDArray[Any], p: NDArray[Any], t: NDArray[Any]) -> Sound:
        """Return sound columns; the last events may wait for the next call (see TimeCourse)."""
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < self._height)
        if not inside.all():
            self._losses.add("out_of_range", int(len(inside) - np.count_nonzero(inside)))
            x, y, p, t = x[inside], y[inside], p[inside], t[inside]
        on = p if p.dtype == np.bool_ else p > 0
        columns: Sound = x.astype(np.uint16), y.astype(np.uint16), on, _whole(t)
        if len(self._held[0]):
            columns = _joined(self._held, columns)
        return self._mended(columns, final=False)

    def finish(self) -> Sound:
        """Return the events that still wait."""
        return self._mended(self._held, final=True)

    def _mended(self, columns: Sound, final: bool) -> Sound:
        x, y, p, t = columns
        time, count = self._course.mend(t, final)
        self._held = x[count:], y[count:], p[count:], t[count:]
        return x[:count], y[:count], p[:count], time


def _joined(first: Sound, second: Sound) -> Sound:
    x, y, p, t = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    return x.astype(np.uint16), y.astype(np.uint16), p.astype(np.bool_), t.astype(np.int64)


def _none() -> Sound:
    words = np.empty(0, np.uint16)
    return words, words, np.empty(0, np.bool_), np.empty(0, np.int64)


def _whole(t: NDArray[Any]) -> NDArray[np.int64]:
    """Return times as whole microseconds within the limits (a copy where they were not)."""
    if t.dtype.kind == "f":
        t = np.rint(np.nan_to_num(t))
    if t.dtype.kind == "u":
        t = np.minimum(t, np.uint64(TIME_LIMIT_US))
    return np.clip(t, -TIME_LIMIT_US, TIME_LIMIT_US).astype(np.int64)
