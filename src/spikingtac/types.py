"""The values that travel between the stages, and the conventions they share.

Conventions, stated once: (x, y) in px with the origin at the centre of the top-left pixel, y
down; images are indexed ``[y, x]``; marker index is row-major (rows top to bottom, then left to
right); geometry in mm; time in integer microseconds (``_us``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

FloatArray = NDArray[np.float64]  # Array of float64; each use states its shape.
US_PER_S = 1_000_000
KPA_PER_MPA = 1e3  # Moduli are configured in kPa; tractions are in N/mm², which is MPa.
US_PER_DAY = 86_400 * US_PER_S

# Types of the columns x, y, p and t of events.
TYPES = [np.dtype(name) for name in ("u2", "u2", "?", "i8")]

# Longer arrays are printed by type and shape, longer values are cut.
MOST_NUMBERS, MOST_LETTERS = 6, 60


def one_line(self: Any) -> str:
    """Return a dataclass in one line, as its ``__repr__``; what is None is left out."""
    shown = [
        f"{one.name}={_short(value)}"
        for one in fields(self)
        if one.repr and (value := getattr(self, one.name)) is not None
    ]
    return f"{type(self).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size > MOST_NUMBERS:
        return f"<{value.dtype} {value.shape}>"
    text = " ".join(repr(value).split())
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."


# White markers on dark ground, or dark markers on light ground.
Polarity = Literal["white", "dark"]

LawName = Literal["none", "paper", "anchored"]  # Laws of the output position, by name.


@dataclass(frozen=True, slots=True)
class EventPacket:
    """Consecutive events of one camera, as columns.

    Invariants: columns of equal length and of the types below, ``t`` never decreasing and inside
    ``[t_start_us, t_end_us)``, ``x < width``, ``y < height``. Making a packet checks nothing. What
    tracks, cuts, buffers or writes packets first checks each one that is not marked as checked
    (:meth:`sound`); readers of files and cameras hand out checked ones. Parts of a checked packet
    are checked. Nothing compares a packet with the one before it.

    Attributes:
        x: ``uint16[n]`` column, px.
        y: ``uint16[n]`` row, px.
        p: ``bool[n]`` polarity, True where the pixel became brighter (+1).
        t: ``int64[n]`` time, us.
        t_start_us: First microsecond that the packet covers.
        t_end_us: First microsecond after the packet (half-open).
        size: ``(width, height)`` of the sensor, px.
        checked: Whether the invariants are known to hold.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.bool_]
    t: NDArray[np.int64]
    t_start_us: int
    t_end_us: int
    size: tuple[int, int]
    checked: bool = field(default=False, repr=False, compare=False)

    __repr__ = one_line

    def __len__(self) -> int:
        return len(self.t)

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)`` of an image of the sensor."""
        return (self.size[1], self.size[0])

    @property
    def pixels(self) -> int:
        """Number of pixels of the sensor."""
        return self.size[0] * self.size[1]

    @classmethod
    def empty(cls, t_start_us: int, t_end_us: int, size: tuple[int, int]) -> EventPacket:
        """Return a packet that covers a stretch of silence."""
        xy, p, t = np.empty(0, np.uint16), np.empty(0, np.bool_), np.empty(0, np.int64)
        return cls(xy, xy, p, t, t_start_us, t_end_us, size, checked=True)

    def part(self, first: int, last: int, t_start_us: int, t_end_us: int) -> EventPacket:
        """Return events ``first`` to ``last`` (exclusive) as a packet of the given span (views)."""
        part = slice(first, last)
        columns = self.x[part], self.y[part], self.p[part], self.t[part]
        return EventPacket(*columns, t_start_us, t_end_us, self.size, self.checked)

    def split(self, t_us: int) -> tuple[EventPacket, EventPacket]:
        """Return what comes before a time, us, and the rest (views)."""
        first = int(self.t.searchsorted(t_us))
        before = self.part(0, first, min(self.t_start_us, t_us), t_us)
        return before, self.part(first, len(self), t_us, self.t_end_us)

    def select(self, keep: NDArray[Any]) -> EventPacket:
        """Return the events that a mask or an index array keeps, over the same span."""
        columns = self.x[keep], self.y[keep], self.p[keep], self.t[keep]
        return EventPacket(*columns, self.t_start_us, self.t_end_us, self.size, self.checked)

    def sound(self) -> EventPacket:
        """Check the columns once and return the packet, marked as checked.

        Lists and other integers become the columns' own types; a polarity may be 0 or 1.

        Raises:
            ConfigError: The columns break an invariant (see the class).
        """
        if not self.checked:
            if [getattr(column, "dtype", None) for column in self._columns()] != TYPES:
                self._convert()
            self._refuse_unsound()
            object.__setattr__(self, "checked", True)  # a copy takes as long as the check itself
        return self

    def _columns(self) -> tuple[NDArray[Any], ...]:
        return self.x, self.y, self.p, self.t

    def require_map(self, shape: tuple[int, ...]) -> None:
        """Refuse a map ``(height, width)`` of another sensor, and events that leave the map.

        Raises:
            ConfigError: The packet has another size, or its columns do not fit it.
        """
        width, height = self.size
        if shape != (height, width):
            raise ConfigError(
                f"events of a {width}x{height} sensor do not fit a map of "
                f"{shape[1]}x{shape[0]}; make the map with the size of the recording"
            )
        self.sound()

    def _convert(self) -> None:
        """Give the columns their own types, where that changes no value."""
        for name, kind, given in zip("xypt", TYPES, map(np.asarray, self._columns()), strict=True):
            column = given.astype(kind) if given.dtype.kind in "iub" or not given.size else given
            if column.dtype != kind or (column != given).any():
                span = f"{given.dtype} from {given.min()} to {given.max()}"
                raise ConfigError(
                    f"a packet's column {name} is {span}; give {kind.name}, or integers that fit "
                    "into it (a polarity of -1 and 1 as p > 0)"
                )
            object.__setattr__(self, name, column)

    def _refuse_unsound(self) -> None:
        columns, count = self._columns(), len(self.t)
        if not self.x.shape == self.y.shape == self.p.shape == (count,) == self.t.shape:
            lengths = ", ".join(str(column.shape).strip("(,)") for column in columns)
            raise ConfigError(
                f"a packet's columns x, y, p and t must be rows of equal length, not {lengths}"
            )
        if not count:
            return
        for name, column, limit in zip("xy", columns, self.size, strict=False):
            if not np.maximum.reduce(column) < limit:
                raise ConfigError(
                    f"events at {name} from {column.min()} to {column.max()} px lie outside of the "
                    f"{self.size[0]}x{self.size[1]} px sensor; drop them, or give the true size"
                )
        first_us, last_us = self.t.item(0), self.t.item(-1)
        falls = (self.t[1:] < self.t[:-1]).any()
        if falls or first_us < self.t_start_us or last_us >= self.t_end_us:
            valid = f"they must lie in [{self.t_start_us}, {self.t_end_us}): give the events' span"
            why = "they fall in between: sort the events" if falls else valid
            raise ConfigError(f"a packet's times go from {first_us} to {last_us} us; {why}")

    @classmethod
    def concatenate(cls, packets: list[EventPacket]) -> EventPacket:
        """Join packets that follow each other in time; at least one is needed."""
        x, y, p, t = (
            np.concatenate([getattr(packet, name) for packet in packets]) for name in "xypt"
        )
        span_us = packets[0].t_start_us, packets[-1].t_end_us
        return cls(x, y, p, t, *span_us, packets[0].size, all(one.checked for one in packets))


@dataclass(frozen=True, slots=True)
class SourceHealth:
    """What a source of events is known to have lost so far, and how much it sends: a snapshot.

    Attributes:
        gaps: Stretches that are missing, a camera that was gone included.
        overflows: Buffers that overran on the way.
        damaged: Places where the decoder had to mend or to drop something.
        reconnects: How often the camera came back.
        rate_ev_s: Events per second in the latest full tenth of a second.
    """

    gaps: int = 0
    overflows: int = 0
    damaged: int = 0
    reconnects: int = 0
    rate_ev_s: float = 0.0

    def summary(self) -> dict[str, float]:
        """Return the counters for a report."""
        return {**asdict(self), "rate_ev_s": round(self.rate_ev_s, 1)}


@dataclass(frozen=True, slots=True)
class MarkerFrame:
    """The markers at one time; every stage's output stays inspectable.

    Attributes:
        t_us: Time of the estimate, us.
        detected_px: ``(m, 2)`` the truthful estimate, px.
        position_px: ``(m, 2)`` after the hysteresis law, px.
        displacement_px: ``(m, 2)`` position minus reference, px.
        coasted: ``(m,)`` True where the marker coasts: its position is predicted, not observed.
        confidence: ``(m,)`` from 0 (no support) to 1.
        health: State of the events up to then, as far as their source was read: it reads ahead in
            files, not on a camera. Whoever drives the tracker adds it.
    """

    t_us: int
    detected_px: NDArray[np.float64]
    position_px: NDArray[np.float64]
    displacement_px: NDArray[np.float64]
    coasted: NDArray[np.bool_]
    confidence: NDArray[np.float64]
    health: SourceHealth = SourceHealth()

    __repr__ = one_line

    def with_health(self, health: SourceHealth) -> MarkerFrame:
        """Return the same estimate with the health of the events that it rests on."""
        return replace(self, health=health)


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact decision: when, and the count that exceeded which threshold."""

    t_us: int
    count: float
    threshold: float


@dataclass(frozen=True, slots=True)
class Pose:
    """Position ``(3,)`` in mm and rotation ``(3, 3)`` of a body in a named frame."""

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    frame: str = "base"


class LossCounters(dict[str, int]):
    """How often each kind of damage or loss was met; absent kinds count zero."""

    def __missing__(self, kind: str) -> int:
        return 0

    def add(self, kind: str, times: int = 1) -> None:
        """Count ``times`` more of ``kind`` (nothing is stored for zero)."""
        if times:
            self[kind] = self[kind] + times

    def kinds(self) -> Iterator[tuple[str, int]]:
        """Yield (kind, count) in order of name."""
        return iter(sorted(self.items()))
