"""Which column of a table is x, y, polarity and time: told by its name, else decided by its values.

Values decide like this: polarity holds two values such as 0 and 1; coordinates are whole numbers
from 0 on, y right behind x; time never falls, or holds what no coordinate can be. A table that can
be read in two ways is refused.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import FormatError

ROLES: tuple[str, ...] = ("x", "y", "p", "t")

# Coordinates at or beyond it are not believed where no name tells them (the largest event sensor
# on the market has 1280 columns).
COORDINATE_LIMIT_PX = 1 << 13

US_PER_UNIT = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}
_UNITS = {
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "ms": "ms", "msec": "ms",
    "millisecond": "ms", "milliseconds": "ms", "millis": "ms", "us": "us", "usec": "us",
    "µs": "us", "μs": "us", "microsecond": "us", "microseconds": "us", "micros": "us", "ns": "ns",
    "nsec": "ns", "nanosecond": "ns", "nanoseconds": "ns", "nanos": "ns",
}  # fmt: skip
_NAMES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps", "stamp"),
    "x": ("x", "xs", "col", "column", "columns", "u"),
    "y": ("y", "ys", "row", "rows", "v"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on", "sign", "is_increase", "is_on"),
}
_ROLE_OF = {name: role for role, names in _NAMES.items() for name in names}
_NAME = re.compile(
    r"(?P<name>[a-zµμ][\w.µμ]*?)(?:_(?P<px>px|pixel|pixels|coord|address))?"
    r"(?:[\s_/]*[\[({<]\s*(?P<unit>[^\])}>]*)[\])}>])?"
)
_PREFIX = re.compile(r"^(events?|ev|dvs|cd)[._/]")

# Whole numbers beyond are nanoseconds since 1970: as microseconds, they lie 3,000 years ahead.
NANOSECOND_TIMES = 1e17

# Mean step between events below which times with fractions are seconds: twenty events a second.
# As microseconds it would be 20 million events a second, more than any such file holds (ours).
SECONDS_STEP = 0.05

RARE_SHARE = 0.01  # Values of a polarity that make up less of a sample are taken for damage.

# What -1 becomes in unsigned numbers.
_WRAPPED = frozenset({(1 << bits) - 1 for bits in (8, 16, 32, 64)})


@dataclass(frozen=True, kw_only=True)
class Order:
    """Where the four columns are.

    Attributes:
        place: Role -> index of its column.
        unit: Unit of the times that a name told: s, ms, us or ns; None where none did.
    """

    place: dict[str, int]
    unit: str | None = None


def role_of(name: str) -> tuple[str | None, str | None]:
    """Return the role that a column's name tells, and the unit of a time.

    Example:
        >>> role_of("t [us]"), role_of("timestamp_ns"), role_of("Polarity"), role_of("gain")
        (('t', 'us'), ('t', 'ns'), ('p', None), (None, None))
    """
    found = _NAME.fullmatch(name.strip().strip("\"' ").lower())
    if found is None:
        return None, None
    word = _PREFIX.sub("", found["name"])
    words = re.findall(r"[a-zµμ]+", found["unit"] or "")
    unit = next((_UNITS[each] for each in words if each in _UNITS), None)
    if word in _ROLE_OF:
        return _ROLE_OF[word], unit
    if word in _UNITS:
        return "t", _UNITS[word]
    stem, _, ending = word.rpartition("_")
    role = _ROLE_OF.get(stem)
    return (role, _UNITS[ending]) if role == "t" and ending in _UNITS else (None, None)


def order_named(names: Sequence[str]) -> Order | None:
    """Return the order that names tell; None unless each role is named exactly once."""
    place: dict[str, int] = {}
    unit = None
    for index, name in enumerate(names):
        role, told = role_of(name)
        if role is None:
            continue
        if role in place:
            return None
        place[role] = index
        unit = told if role == "t" else unit
    return Order(place=place, unit=unit) if len(place) == len(ROLES) else None


def order_of_values(samples: Iterable[NDArray[Any]], where: str) -> Order:
    """Return the order that the values of a table allow.

    Args:
        samples: ``(n, k)`` rows from one or several places of the table, in their order.
        where: The table, for errors.

    Raises:
        FormatError: No order fits, or several do; names them.
    """
    parts = [part.astype(np.float64) for part in samples if len(part)]
    table = np.concatenate(parts)
    columns = range(table.shape[1])
    coordinates = [k for k in columns if _may_be_coordinate(table[:, k])]
    signs = [k for k in columns if _may_be_polarity(table[:, k])]
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
        return Order(place=readings[0])
    found = "; ".join(_spoken(reading, len(columns)) for reading in readings[:4])
    reason = f"can be read in several ways: {found}" if readings else "fit no order of t, x, y, p"
    raise FormatError(
        f"{where}: the {len(columns)} columns {reason}; name them in a first line such as t,x,y,p "
        "(wanted: whole x and y from 0 on, polarity 0 and 1 or -1 and 1, ascending time)"
    )


def _may_be_coordinate(column: NDArray[np.float64]) -> bool:
    whole = column == np.rint(column)
    return bool((whole & (column >= 0) & (column < COORDINATE_LIMIT_PX)).all())


def _may_be_polarity(column: NDArray[np.float64]) -> bool:
    values = set(np.unique(column[: 1 << 16]).tolist())
    return any(values <= pair for pair in ({0, 1}, {-1, 1}, *({0, 1, w} for w in _WRAPPED)))


def _spoken(reading: dict[str, int], columns: int) -> str:
    names = {index: role for role, index in reading.items()}
    return ",".join(names.get(index, "-") for index in range(columns))


class ToPolarity:
    """Turns a column of polarities into booleans, by the values of its first rows.

    Raises:
        FormatError: They hold other values than 0 and 1, -1 and 1, wrapped ones, or 0 and 255.
    """

    def __init__(self, sample: NDArray[Any], where: str) -> None:
        values, counts = np.unique(sample, return_counts=True)
        usual = {float(v) for v in values[counts >= RARE_SHARE * max(len(sample), 1)]}
        self._wrapped = bool(usual & {float(w) for w in _WRAPPED}) and 1.0 in usual
        self._wrapped |= bool(usual & {float((1 << 32) - 1), float((1 << 64) - 1)})
        valid = {-1.0, 0.0, 1.0, *map(float, _WRAPPED)}
        if usual - valid:
            raise FormatError(
                f"{where}: the polarity holds {_listed(usual)}; valid: 0 and 1, -1 and 1, or true "
                "and false"
            )

    def __call__(self, p: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which events are ON."""
        if p.dtype == np.bool_:
            return p
        return p == 1 if self._wrapped else p > 0


def _listed(values: set[float]) -> str:
    told = [f"{value:g}" for value in sorted(values)[:6]]
    return ", ".join([*told, "..."] if len(values) > len(told) else told)


class ToMicroseconds:
    """Turns a column of times into microseconds; the unit is told, or guessed by the first rows.

    Args:
        sample: Times of the first rows.
        unit: Unit that a name told, or None.

    Attributes:
        note: What was assumed, or empty.
    """

    def __init__(self, sample: NDArray[Any], unit: str | None = None) -> None:
        self.note = ""
        if unit is None and in_seconds(sample):
            unit, self.note = "s", "the times have fractions and are taken for seconds"
        if unit is None and len(sample) and float(np.abs(sample).max()) > NANOSECOND_TIMES:
            unit, self.note = "ns", "the times are beyond 1e17 and are taken for nanoseconds"
        self._unit = unit or "us"

    def __call__(self, t: NDArray[Any]) -> NDArray[Any]:
        """Return the times in microseconds; whole ones stay whole."""
        if self._unit == "us":
            return t
        if t.dtype.kind in "iu":
            if self._unit == "ns":
                return (t + t.dtype.type(500)) // t.dtype.type(1000)
            return t.astype(np.int64) * int(US_PER_UNIT[self._unit])
        return t.astype(np.float64) * US_PER_UNIT[self._unit]


def in_seconds(t: NDArray[Any]) -> bool:
    """Return whether the times of the first events look like seconds: fractions, and small steps.

    Args:
        t: ``(n,)`` numbers of any type.
    """
    if t.dtype.kind != "f":
        return False
    times = t[np.isfinite(t)].astype(np.float64)
    if len(times) < 1 or not (times != np.rint(times)).any():
        return False
    steps = np.abs(np.diff(times))
    return float(np.median(steps)) < SECONDS_STEP if len(steps) else True
