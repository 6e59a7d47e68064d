"""One protocol for every origin of events, and the health of a stream as five numbers.

Sources count what they lost by kind (``codec.KINDS``); whoever acts on a stream needs fewer words.
Everything here goes by the times of the events, so the packing of a stream does not matter.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import require_type
from spikingtac.types import US_PER_S, EventPacket, LossCounters, SourceHealth


@runtime_checkable
class EventSource(Protocol):
    """A stream of events that is pulled, packet by packet.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: What was lost or mended so far, by kind; complete when the iteration has ended.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield packets of any length that follow each other in time without gaps in their spans.

        A file may be iterated again from its beginning; a camera or a simulation goes on.
        """
        ...


class PacketSource:
    """An :class:`EventSource` over packets in memory, for tests and for sliced recordings."""

    def __init__(self, packets: Iterable[EventPacket], size: tuple[int, int]) -> None:
        self.size = size
        self.losses = LossCounters()
        self._packets = packets

    def __iter__(self) -> Iterator[EventPacket]:
        return iter(self._packets)


OPENED = "open_events('a.raw')"  # How a source is made, for errors.


def refuse_path(given: object) -> None:
    """Refuse a file's path, or anything else that yields no packets, where events are expected.

    Raises:
        ConfigError: It is a path, an array, a table or a single value; says how to open a file.
    """
    values, ones = str | os.PathLike | np.ndarray, given if isinstance(given, list) else [given]
    plain = any(isinstance(one, values) or hasattr(one, "keys") for one in ones)
    if plain or not isinstance(given, Iterable):
        path = given if isinstance(given, str | os.PathLike) else "a.raw"
        require_type(given, EventSource, f"open_events({os.fspath(path)!r})")


# Kinds of loss that lose nothing; ``strict`` does not refuse them.
HARMLESS = frozenset({
    "trigger", "padding", "vendor_word", "duplicate", "before_zero", "other_data",
    "hot_pixels",
})  # fmt: skip

# Kind of loss -> the counter that it belongs to; every other kind is damage, or loses nothing.
COUNTERS = {
    "gap": "gaps", "silences": "gaps", "time_jump": "gaps", "disconnected": "gaps",
    "overflow": "overflows", "missed": "overflows", "reconnected": "reconnects",
}  # fmt: skip

# Stretch over which the rate is told, us (a press lasts longer, and at 320x320 px a resting
# sensor sends some events in it).
SLOT_US = 100_000


def source_health(losses: Mapping[str, int], rate_ev_s: float = 0.0) -> SourceHealth:
    """Return the counters behind the kinds that a source has counted.

    Args:
        losses: Kind -> how often; what loses nothing is passed over, every other kind is damage.
        rate_ev_s: Events per second.
    """
    found = LossCounters()
    for kind, count in losses.items():
        if kind not in HARMLESS:
            found.add(COUNTERS.get(kind, "damaged"), count)
    return SourceHealth(**found, rate_ev_s=rate_ev_s)


def slot_rate_ev_s(t_us: int, first_us: int, count_between: Callable[[int, int], int]) -> float:
    """Return the rate in the latest full slot of 0.1 s before a time, events per second.

    Args:
        t_us: The time, us.
        first_us: Where the stream begins; it may lie within a slot.
        count_between: Returns the events from one time to before another.

    Returns:
        0 while none is full.
    """
    until_us = t_us // SLOT_US * SLOT_US
    from_us = max(until_us - SLOT_US, first_us)
    if from_us >= until_us:
        return 0.0
    return count_between(from_us, until_us) * US_PER_S / (until_us - from_us)


class HealthMeter:
    """Follows a stream and reports its health; the object is reused while nothing changes.

    Args:
        losses: What the source counts while it is read.
    """

    def __init__(self, losses: Mapping[str, int]) -> None:
        self._losses, self._counted = losses, dict[str, int]()
        self._latest, self._rate_ev_s = SourceHealth(), 0.0
        self._span_us: tuple[int, int] | None = None
        self._events, self._slot_us = 0, 0
        self._slot: list[NDArray[np.int64]] = []  # times of the events of the present slot

    def absorb(self, packet: EventPacket) -> None:
        """Count the events of the next stretch of the stream."""
        if self._span_us is None:
            self._span_us = packet.t_start_us, packet.t_end_us
            self._slot_us = packet.t_start_us // SLOT_US * SLOT_US
        first_us, self._span_us = self._span_us[0], (self._span_us[0], packet.t_end_us)
        self._events += len(packet)
        self._slot.append(packet.t)
        reached_us = packet.t_end_us // SLOT_US * SLOT_US
        if reached_us > self._slot_us:
            t = np.concatenate(self._slot)
            self._rate_ev_s = slot_rate_ev_s(
                reached_us, first_us, lambda *span_us: int(np.diff(t.searchsorted(span_us))[0])
            )
            self._slot, self._slot_us = [t[t.searchsorted(reached_us) :]], reached_us

    def now(self) -> SourceHealth:
        """Return the health up to the end of what was absorbed."""
        if self._losses != self._counted or self._latest.rate_ev_s != self._rate_ev_s:
            self._counted = dict(self._losses)
            self._latest = source_health(self._counted, self._rate_ev_s)
        return self._latest

    def total(self) -> SourceHealth:
        """Return the health with the mean rate of all that was absorbed."""
        first_us, last_us = self._span_us or (0, 0)
        return source_health(self._losses, self._events * US_PER_S / max(last_us - first_us, 1))
