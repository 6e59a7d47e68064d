"""What tables of events have in common: units, polarities and the order of their rows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.codec import RESET_US
from spikingtac.events.formats.file_source import FileSource, Rows
from spikingtac.events.tables.columns import ToMicroseconds, ToPolarity

# All rows are sorted where more than this share of the first ones, and more than a few, come
# before their predecessor: a restart is one such row, shuffled rows are half (ours).
UNSORTED_SHARE, FEW_FALLS = 0.02, 3

SORTED_ROWS_LIMIT = 1 << 25  # Most rows that are sorted, in memory: 33 million take 1.2 GB.

CHUNK_ROWS = 1 << 17


class TableSource(FileSource):
    """Events of a table, in whatever unit and order; a file format yields its rows.

    Rows out of order are sorted by time and counted as ``unsorted``: all of them where many are,
    else those within one chunk. A fall of 0.1 s or more in an ordered table is a restart.

    Raises:
        FormatError: The table holds no events and names no size, its polarity cannot be read, or it
            is out of order and too long to be sorted.
    """

    _named_size: tuple[int, int] | None = None
    _unit: str | None = None
    _offset_us: int = 0

    def _rows(self) -> Iterator[Rows]:
        """Yield columns x, y, p and t as they stand in the file; count what is wrong."""
        raise NotImplementedError

    def _size(self) -> tuple[int, int]:
        if self._named_size is not None:
            return self._named_size
        if not any(len(t) for _, _, _, t in self._rows()):
            raise FormatError(f"{str(self.path)!r} holds no events: nothing was recorded into it")
        return self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        pieces = self._understood()
        first = next(pieces, None)
        if first is None:
            return
        pieces = itertools.chain((first,), pieces)
        falls = np.count_nonzero(first[3][1:] < first[3][:-1])
        if falls > FEW_FALLS + UNSORTED_SHARE * len(first[3]):
            pieces = self._all_sorted(pieces)
        for rows in pieces:
            yield self._mildly_sorted(rows)

    def _understood(self) -> Iterator[Rows]:
        """Yield the rows with times in microseconds and polarities as booleans."""
        to_us: ToMicroseconds | None = None
        to_on: ToPolarity | None = None
        for x, y, p, t in self._rows():
            if not len(t):
                continue
            if to_us is None or to_on is None:
                to_us = ToMicroseconds(t, self._unit)
                to_on = ToPolarity(p, repr(str(self.path)))
                if to_us.note and to_us.note not in self.notes:
                    self.notes.append(to_us.note)
            t = to_us(t)
            if self._offset_us:
                t = (t.astype(np.int64) if t.dtype.kind in "iu" else t) + self._offset_us
            yield x, y, to_on(p), t

    def _all_sorted(self, pieces: Iterator[Rows]) -> Iterator[Rows]:
        kept: list[Rows] = []
        total = 0
        for rows in pieces:
            total += len(rows[3])
            if total > SORTED_ROWS_LIMIT:
                raise FormatError(
                    f"{str(self.path)!r}: its rows are out of order in time, and more than "
                    f"{SORTED_ROWS_LIMIT} cannot be sorted here; sort the file by time first"
                )
            kept.append(tuple(column.copy() for column in rows))  # type: ignore[arg-type]
        x, y, p, t = (np.concatenate(column) for column in zip(*kept, strict=True))
        kept.clear()
        self.losses.add("unsorted", int(np.count_nonzero(t[1:] < t[:-1])))
        order = np.argsort(t, kind="stable")
        for first in range(0, total, CHUNK_ROWS):
            part = order[first : first + CHUNK_ROWS]
            yield x[part], y[part], p[part], t[part]

    def _mildly_sorted(self, rows: Rows) -> Rows:
        x, y, p, t = rows
        falls = t[1:] < t[:-1]
        if not falls.any() or np.diff(t.astype(np.float64)).min() <= -RESET_US:
            return rows
        self.losses.add("unsorted", int(np.count_nonzero(falls)))
        order = np.argsort(t, kind="stable")
        return x[order], y[order], p[order], t[order]


def rows_of(table: NDArray[np.generic], place: dict[str, int]) -> Rows:
    """Return the columns of a ``(n, k)`` table."""
    return table[:, place["x"]], table[:, place["y"]], table[:, place["p"]], table[:, place["t"]]
