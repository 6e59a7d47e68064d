"""Where a long recording is cut, found by one pass over its events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.formats.codec import Place
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.source_health import source_health

US_PER_S = 1_000_000
OVERLAP_S = 3.0
"""How long before its cut a piece begins, s. A tracker that begins there takes the skin for
resting; what moves meanwhile puts its map right (ours, 26 cuts of the scene fifty-contacts: 0.27 px
mean error after 0.5 s, 0.15 px after 2 s, 0.13 px after 4 s; 0.15 px without a cut)."""
SHARED_US = 300_000
"""How long both pieces go on beyond a cut, to be compared, us."""
SHORTEST_CUT_S = 5.0
"""Below it the overlap would be most of the work."""
LOOK_AROUND = 0.1
"""A cut may lie so much earlier, as a share of the distance of the cuts, where fewer events are."""
TICK_US = 50_000
"""Time over which events are counted to choose a cut, us."""
MOST_TICKS = 1 << 12
"""Most ticks in one chunk of events: a leap of the clock must not make millions."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Piece:
    """A stretch of a recording that is tracked by itself.

    Attributes:
        number: Its place in the recording, from 0 on.
        from_us: Where its events begin, us: the overlap before its cut.
        cut_us: From here on its estimates count, us.
        next_us: Here the next piece's take over, us; None for the last piece.
        to_us: Where its events end, us: a moment after the next cut; None for the last piece.
        place: Where reading begins; None reads from the start and passes over what is before.
    """

    number: int
    from_us: int
    cut_us: int
    next_us: int | None
    to_us: int | None
    place: Place | None

    def is_next_to_cut(self, t_us: int) -> bool:
        """Return whether another piece has estimates of that time, too."""
        behind = self.number > 0 and t_us < self.cut_us + SHARED_US
        return behind or (self.next_us is not None and t_us >= self.next_us)

    def document(self) -> dict[str, Any]:
        """Return the piece as JSON holds it."""
        return asdict(self)

    @classmethod
    def parse(cls, document: dict[str, Any]) -> Piece:
        """Return the piece that :meth:`document` wrote."""
        place = document["place"]
        if place is not None:
            place = Place(**{**place, "state": tuple(place["state"])})
        return cls(**{**document, "place": place})


class PlanPass:
    """One pass over a recording that yields the places where it is cut as it finds them.

    Cuts and beginnings lie at events, in the least busy moment around, so that few markers move
    fast there.

    Args:
        source: The recording.
        cut_s: Distance of the cuts, s of the recording.
        overlap_s: How long before its cut a piece begins, s.

    Attributes:
        first_us: Time of the first event, us; known once there is a piece.
        events: Number of events so far.
        seekable: Whether reading can begin at a piece.

    Raises:
        ConfigError: The cuts are too close.
    """

    def __init__(self, source: FileSource, cut_s: float, overlap_s: float = OVERLAP_S) -> None:
        if not cut_s >= SHORTEST_CUT_S:
            raise ConfigError(f"--cut-s is {cut_s:g}, it must be at least {SHORTEST_CUT_S:g} s")
        self._source = source
        self._cut_us, self._overlap_us = int(cut_s * US_PER_S), int(overlap_s * US_PER_S)
        self._times: list[NDArray[np.int64]] = []
        self._counts: list[NDArray[np.int64]] = []
        self._places: list[Place] = []
        self._last_us = 0
        self.first_us = 0
        self.events = 0

    @property
    def seekable(self) -> bool:
        """Whether reading can begin at a piece: in RAW files, it can."""
        return bool(self._places)

    @property
    def progress(self) -> float:
        """Share of the recording that was read, 0 to 1."""
        return self._source.progress

    def health(self) -> dict[str, float]:
        """Return the health of the whole recording, with its mean rate; known at the end."""
        seconds = max(self._last_us - self.first_us, 1) / US_PER_S
        return source_health(self._source.losses, self.events / seconds).summary()

    def pieces(self) -> Iterator[Piece]:
        """Read the recording and yield its pieces, each as soon as it is known.

        Raises:
            RecordingError: The recording holds no event.
        """
        source, cut, begin, number = self._source, 0, 0, 0
        for t in _times(source):
            if not self.events and len(t):
                self.first_us = cut = begin = int(t[0])
            self._add(t, source.place)
            while self._last_us > cut + self._cut_us + self._cut_us // 2:
                after = self._next_cut(cut)
                yield self._piece(number, begin, cut, after)
                number, cut, begin = number + 1, after, self._beginning(after)
        if not self.events:
            raise RecordingError(f"{str(source.path)!r} holds no events to track")
        yield self._piece(number, begin, cut, None)

    def _add(self, t: NDArray[np.int64], place: Place | None) -> None:
        if not len(t):
            return
        first_us, self._last_us = int(t[0]), int(t[-1])
        count = min(max((self._last_us - first_us) // TICK_US, 1), MOST_TICKS)
        edges = np.unique(t.searchsorted(np.linspace(first_us, self._last_us, count + 1)[:-1]))
        self._times.append(t[edges].astype(np.int64))
        self._counts.append(np.diff(edges, append=len(t)))
        if place is not None:
            self._places.append(place)
        self.events += len(t)

    def _next_cut(self, cut: int) -> int:
        target_us = cut + self._cut_us
        calm = self._calmest(target_us - int(LOOK_AROUND * self._cut_us), target_us)
        if calm is not None:
            return calm
        times = np.concatenate(self._times)  # in a silence: at the event that ends it
        return int(times[times.searchsorted(target_us)])

    def _beginning(self, cut: int) -> int:
        latest_us = cut - self._overlap_us
        calm = self._calmest(latest_us - self._overlap_us // 2, latest_us)
        if calm is not None:
            return calm
        times = np.concatenate(self._times)  # in a silence: at the last event before it
        return int(times[max(int(times.searchsorted(latest_us)) - 1, 0)])

    def _calmest(self, from_us: int, to_us: int) -> int | None:
        """Return where the least busy tick of a stretch begins, or None where it has no event."""
        times, counts = np.concatenate(self._times), np.concatenate(self._counts)
        first, last = times.searchsorted((from_us, to_us))
        return int(times[first + int(counts[first:last].argmin())]) if last > first else None

    def _piece(self, number: int, from_us: int, cut_us: int, after: int | None) -> Piece:
        reached = np.array([place.t_us for place in self._places], np.int64)
        before = int(reached.searchsorted(from_us)) - 1  # its last event is before the first one
        return Piece(
            number=number,
            from_us=from_us,
            cut_us=cut_us,
            next_us=after,
            to_us=None if after is None else after + SHARED_US,
            place=self._places[before] if before >= 0 else None,
        )


def _times(source: FileSource) -> Iterator[NDArray[np.int64]]:
    """Yield times in order: columns where they come checked, which spares copies."""
    if source.checked:
        yield from (t for _, _, _, t in source.columns())
    else:
        yield from (packet.t for packet in source)
