"""Which column of a table is x, y, polarity and time: told by its name, else decided by its values.

Values decide like this: polarity holds two values such as 0 and 1; coordinates are whole numbers
from 0 on, y right behind x; time never falls, or holds what no coordinate can be. A table that can
be read in two ways is refused.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError
from spikingtac.events.formats.codec import RESET_US
from spikingtac.events.formats.file_source import FileSource, Rows
from spikingtac.events.formats.packing import chosen_rows, finite_rows

ROLES: tuple[str, ...] = ("x", "y", "p", "t")
# Coordinates at or beyond it are not believed where no name tells them (the largest event sensor
# on the market has 1280 columns).
COORDINATE_LIMIT_PX = 1 << 13

US_PER_UNIT = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3, "frac": 1e6}
_UNIT_NAMES = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millisecond", "milliseconds", "millis"),
    "us": ("us", "usec", "usecs", "µs", "μs", "microsecond", "microseconds", "micros"),
    "ns": ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds", "nanos"),
    "frac": ("frac", "fraction", "fractional"),  # of a second, beside whole ones
}
_UNITS = {name: unit for unit, names in _UNIT_NAMES.items() for name in names}
_NAMES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps", "time_stamp", "stamp"),
    "x": ("x", "xs", "xpos", "col", "column", "columns", "u"),
    "y": ("y", "ys", "ypos", "row", "rows", "v"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on", "sign", "is_increase", "is_on"),
}
_ROLE_OF = {name: role for role, names in _NAMES.items() for name in names}
_NAME = re.compile(
    r"(?P<name>[a-zµμ][\w.µμ]*?)(?:_(?:px|pixels?|pos|coord|addr|address)|@\d+)?"
    r"(?:[\s_/]*[\[({<]\s*(?P<unit>[^\])}>]*)[\])}>])?"
)
# Words of a unit that do not count: the type of a column's numbers, blanks behind milli.
_TYPE = re.compile(r"\b(?:u?int|float|double)\d*\s*|(?<=milli|micro)[\s-]+|(?<=nano)[\s-]+")
_PREFIX = re.compile(r"^(events?|ev|dvs|cd|pixel|addr|address)[._/]")

# Whole numbers beyond are nanoseconds since 1970: as microseconds, they lie 3,000 years ahead.
NANOSECOND_TIMES = 1e17
# Mean step between events below which times with fractions are seconds: twenty events a second.
# As microseconds it would be 20 million events a second, more than any such file holds.
SECONDS_STEP = 0.05
RARE_SHARE = 0.01  # Values of a polarity that make up less of a sample are taken for damage.

# All rows are sorted where more than this share of the first ones, and more than a few, come
# before their predecessor: a restart is one such row, shuffled rows are half.
UNSORTED_SHARE, FEW_FALLS = 0.02, 3
SORTED_ROWS_LIMIT = 1 << 25  # Most rows that are sorted, in memory: 33 million take 1.2 GB.

# Four columns, an array ``(n, k)``, or one of structures.
Table = list[NDArray[Any]] | NDArray[Any]
CHUNK_ROWS = 1 << 17
TABLE_WIDTHS = (4, 5)  # Columns of a table of numbers that may be events.
WIDEST_TABLE = 6  # Columns of the widest table that is read; a longer single row is one column.

# What -1 becomes in unsigned numbers; of 8 and 16 bits, it may also stand for true.
_WRAPPED = frozenset({float((1 << bits) - 1) for bits in (8, 16, 32, 64)})
_ONLY_WRAPPED = frozenset({float((1 << bits) - 1) for bits in (32, 64)})
_SIGNS = ({0, 1}, {-1, 1}, *({0, 1, wrapped} for wrapped in _WRAPPED))  # Values of a polarity.


class Order(NamedTuple):
    """Where the four columns are.

    Attributes:
        place: Role -> index of its column; where seconds have their rest in another column, its
            unit, us, ns or frac, -> index of that.
        unit: Unit of the times that a name or an attribute told: s, ms, us or ns; None where none
            did.
    """

    place: dict[str, int]
    unit: str | None = None


def role_of(name: str) -> tuple[str | None, str | None]:
    """Return the role that a column's name tells, and the unit of a time.

    Brackets behind a time must hold a unit: it may be another one, or a multiple.

    Example:
        >>> role_of("t [us]"), role_of("timestamp_ns"), role_of("Polarity"), role_of("t [10 us]")
        (('t', 'us'), ('t', 'ns'), ('p', None), (None, None))
    """
    found = _NAME.fullmatch(name.strip().strip("\"' ").lower())
    if found is None:
        return None, None
    word = _PREFIX.sub("", found["name"]).replace(".", "_")
    told = _TYPE.sub("", found["unit"] or "")
    unit = next(filter(None, map(_UNITS.get, re.findall(r"[a-zµμ]+", told))), None)
    unclear = re.search(r"\d", told) or (told and unit is None)
    stem, _, ending = word.rpartition("_")
    if ending in _UNITS and stem in ("", *_NAMES["t"]):
        word, unit = "t", _UNITS[ending]
    role = _ROLE_OF.get(word)
    return (None, None) if role == "t" and unclear else (role, unit)


def order_named(names: Sequence[str]) -> Order | None:
    """Return the order that names tell; None unless each role is named exactly once."""
    told = [role_of(name) for name in names]
    finer = {("t", "us"), ("t", "ns"), ("t", "frac")} if ("t", "s") in told else set()
    parts = [unit if (role, unit) in finer else role for role, unit in told]
    place = {part: index for index, part in enumerate(parts) if part is not None}
    once = len(place) == len(parts) - parts.count(None) <= len(ROLES) + 1
    unit = "s" if finer else dict(told).get("t")
    return Order(place, unit) if once and {*ROLES} <= place.keys() else None


def laid_out(shape: Sequence[int]) -> tuple[int, int, bool]:
    """Return the rows and columns of an array, and whether its rows lie along the second axis.

    A single row of numbers has 0 columns, also where it has two axes, as MATLAB writes it.
    """
    wide = len(shape) == 2 and shape[1] > shape[0]
    across = wide and (shape[0] in TABLE_WIDTHS or (shape[0] == 1 and shape[1] > WIDEST_TABLE))
    width = int(shape[not across]) if len(shape) == 2 else 0
    return int(shape[across]) if shape else 0, 0 if width == 1 else width, across


def order_of_values(samples: Iterable[NDArray[Any]], where: str) -> Order:
    """Return the order that the values of a table allow.

    Args:
        samples: ``(n, k)`` rows from one or several places of the table, in their order.
        where: The table, for errors.

    Raises:
        FormatError: No order fits, or several do; names them.
    """
    parts = [part.astype(np.float64) for part in samples if len(part)]
    parts = [part[np.isfinite(part).all(axis=1)] for part in parts]
    if not parts:
        raise FormatError(f"{where} holds no events: nothing was recorded into it")
    table = np.concatenate(parts)
    columns = range(table.shape[1])
    whole = (table == np.rint(table)) & (table >= 0) & (table < COORDINATE_LIMIT_PX)
    coordinates = np.flatnonzero(whole.all(axis=0)).tolist()
    values = [{*np.unique(table[: 1 << 16, k]).tolist()} for k in columns]
    signs = [k for k in columns if any(values[k] <= pair for pair in _SIGNS)]
    times = [k for k in columns if not (k in coordinates or k in signs)]
    if not times:
        times = [k for k in columns if all((np.diff(part[:, k]) >= 0).all() for part in parts)]
        times = [k for k in times if table[:, k].min() < table[:, k].max()] or times
    readings = [
        dict(zip(ROLES, (x, y, p, t), strict=True))
        for x, y in itertools.pairwise(columns)
        if x in coordinates and y in coordinates
        for p in signs
        for t in times
        if len({x, y, p, t}) == len(ROLES)
    ]
    if len(readings) == 1:
        return Order(readings[0])
    orders = [{index: role for role, index in reading.items()} for reading in readings[:4]]
    found = "; ".join(",".join(order.get(index, "-") for index in columns) for order in orders)
    reason = f"can be read in several ways: {found}" if readings else "fit no order of t, x, y, p"
    raise FormatError(
        f"{where}: the {len(columns)} columns {reason}; name them, in a first line t,x,y,p or in "
        "an .npz (wanted: whole x and y from 0 on, polarity 0 and 1 or -1 and 1, ascending time)"
    )


def _holds_wrapped(p: NDArray[Any], where: str) -> bool:
    """Return whether OFF stands for -1 in unsigned numbers, by the polarities of the first rows.

    Raises:
        FormatError: They hold other values than 0 and 1, -1 and 1, wrapped ones, or 0 and 255.
    """
    values, counts = np.unique(p, return_counts=True)
    usual = {float(v) for v in values[counts >= RARE_SHARE * max(len(p), 1)]}
    if usual - {-1.0, 0.0, 1.0} - _WRAPPED or usual == {-1.0, 0.0}:
        told = ", ".join(f"{value:g}" for value in sorted(usual)[:6])
        raise FormatError(
            f"{where}: the polarity holds {told}; valid: 0 and 1, -1 and 1, or true and false"
        )
    return bool(usual & _WRAPPED) and (1.0 in usual or bool(usual & _ONLY_WRAPPED))


def _guessed_unit(t: NDArray[Any]) -> tuple[str, str]:
    """Return the unit that the times of the first rows look like, and what was assumed."""
    if t.dtype.kind == "f" and (t != np.rint(t)).any():
        near = len(t) == 1 or float(np.median(np.diff(np.sort(t)))) < SECONDS_STEP
        name = "seconds" if near else "microseconds (a header such as t_ms,x,y,p tells)"
        return "s" if near else "us", f"the times have fractions and are taken for {name}"
    if float(np.abs(t).max()) > NANOSECOND_TIMES:
        return "ns", "the times are beyond 1e17 and are taken for nanoseconds"
    return "us", ""


def _in_us(t: NDArray[Any], unit: str) -> NDArray[Any]:
    """Return times in microseconds; whole ones stay whole."""
    if unit == "us":
        return t
    if t.dtype.kind not in "iu":
        return t.astype(np.float64) * US_PER_UNIT[unit]
    if unit == "ns":
        return (t + t.dtype.type(500)) // t.dtype.type(1000)
    return t.astype(np.int64) * int(US_PER_UNIT[unit])


class TableSource(FileSource):
    """Events of a table, in whatever unit and order; a file format yields its rows.

    Rows out of order are sorted by time and counted as ``unsorted``: all of them where many are,
    else those within one chunk. A fall of 0.1 s or more in an ordered table is a restart.

    Raises:
        FormatError: The table holds no events and names no size, its polarity cannot be read, or it
            is out of order and too long to be sorted.
    """

    _order = Order({})
    _offset_us: int = 0

    def _tables(self) -> Iterator[Table]:
        """Yield the columns as they stand in the file, in ``_order``; count what is wrong."""
        raise NotImplementedError

    def _size(self) -> tuple[int, int]:
        if self._named_size is None and next(self._understood(), None) is None:
            damage = ", ".join(f"{kind} {count}" for kind, count in self.losses.kinds())
            told = f"none can be read ({damage})" if damage else "nothing was recorded into it"
            raise FormatError(f"{str(self.path)!r} holds no events: {told}")
        return super()._size()

    def _columns(self) -> Iterator[Rows]:
        pieces = self._understood()
        first = next(pieces, None)
        if first is None:
            return
        pieces = itertools.chain((first,), pieces)
        falls = np.count_nonzero(first[3][1:] < first[3][:-1])
        shuffled = falls > FEW_FALLS + UNSORTED_SHARE * len(first[3])
        for rows in [self._joined(pieces)] if shuffled else pieces:
            t = rows[3]
            fallen = t[1:] < t[:-1]
            # A fall of 0.1 s or more in an ordered table is a restart.
            if fallen.any() and (shuffled or np.diff(t.astype(np.float64)).min() > -RESET_US):
                self.losses.add("unsorted", int(np.count_nonzero(fallen)))
                rows = chosen_rows(rows, np.argsort(t, kind="stable"))
            for begin in range(0, len(t), CHUNK_ROWS):
                yield chosen_rows(rows, slice(begin, begin + CHUNK_ROWS))

    def _joined(self, pieces: Iterator[Rows]) -> Rows:
        """Return all rows at once, as many as can be sorted in memory."""
        kept: list[Rows] = []
        for rows in pieces:
            kept.append(rows)
            if sum(len(part[3]) for part in kept) > SORTED_ROWS_LIMIT:
                raise FormatError(
                    f"{str(self.path)!r}: its rows are out of order in time, and more than "
                    f"{SORTED_ROWS_LIMIT} cannot be sorted here; sort the file by time first"
                )
        x, y, p, t = (np.concatenate(column) for column in zip(*kept, strict=True))
        return x, y, p, t

    def _understood(self) -> Iterator[Rows]:
        """Yield the rows with times in microseconds and polarities as booleans."""
        unit, wrapped = "", False
        for table in self._tables():
            x, y, p, t = (_column(table, self._order.place[role]) for role in ROLES)
            for part in US_PER_UNIT.keys() & self._order.place.keys():
                rest_s = _column(table, self._order.place[part]) * (US_PER_UNIT[part] / 1e6)
                if (t % 1 > 0).any() or (rest_s >= 1.0).any():
                    raise FormatError(f"{str(self.path)!r} names the time twice; leave one out")
                t = t + rest_s
            x, y, p, t = finite_rows((x, y, p, t), self.losses)
            if not len(t):
                continue
            if not unit:
                unit, note = (self._order.unit, "") if self._order.unit else _guessed_unit(t)
                wrapped = _holds_wrapped(p, repr(str(self.path)))
                if note and note not in self.notes:
                    self.notes.append(note)
            t_us = _in_us(t, unit)
            if self._offset_us:
                whole = t_us.dtype.kind in "iu"
                t_us = (t_us.astype(np.int64) if whole else t_us) + self._offset_us
            yield x, y, p if p.dtype == np.bool_ else p == 1 if wrapped else p > 0, t_us


def _column(table: Table, index: int) -> NDArray[Any]:
    if isinstance(table, list):
        return table[index]
    return table[table.dtype.names[index]] if table.dtype.names else table[:, index]
