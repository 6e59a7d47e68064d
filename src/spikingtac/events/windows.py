"""Cut a stream at given times; regular windows keep the empty ones, since silence is data."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

from spikingtac.types import EventPacket

_WINDOWS_AT_ONCE = 1000
"""Windows of a long packet whose edges are searched together."""


def cut(packets: Iterable[EventPacket], edges_us: Iterator[int]) -> Iterator[EventPacket]:
    """Yield one packet for each stretch between consecutive edges.

    The stream before the first edge is dropped. The last packet ends where the stream ends, if that
    is before the next edge.

    Args:
        packets: Packets in order of time, of any length.
        edges_us: Increasing times, us; endless iterators are fine.
    """
    start = next(edges_us, None)
    end = next(edges_us, None)
    parts: list[EventPacket] = []
    reached: int | None = None
    for packet in packets:
        while start is not None and end is not None and packet.t_end_us >= end:
            parts.append(_between(packet, start, end))
            yield _joined(parts, start, end)
            parts, start, end = [], end, next(edges_us, None)
        if start is None or end is None:
            return
        if packet.t_end_us > start:
            parts.append(_between(packet, start, end))
            reached = packet.t_end_us
    if start is not None and end is not None and parts and reached is not None and reached > start:
        yield _joined(parts, start, min(end, reached))


def windows(
    packets: Iterable[EventPacket], period_us: int, t_start_us: int | None = None
) -> Iterator[EventPacket]:
    """Yield regular half-open windows of ``period_us``, including the empty ones.

    Args:
        packets: Packets in order of time, of any length.
        period_us: Length of a window, us.
        t_start_us: Where the first window begins; None begins at the first packet.

    Raises:
        ValueError: The period is not positive.
    """
    if period_us < 1:
        raise ValueError(f"period_us is {period_us}, it must be at least 1")
    stream = iter(packets)
    first = next(stream, None)
    if first is None:
        return
    origin = first.t_start_us if t_start_us is None else t_start_us
    yield from _regular(itertools.chain((first,), stream), period_us, origin)


def _regular(packets: Iterable[EventPacket], period_us: int, start: int) -> Iterator[EventPacket]:
    """Do what :func:`cut` does at regular edges, searching many of them in a packet at once."""
    parts: list[EventPacket] = []
    for packet in packets:
        if packet.t_end_us - start >= period_us and (parts or packet.t_start_us > start):
            parts.append(_between(packet, start, start + period_us))
            yield _joined(parts, start, start + period_us)
            parts, start = [], start + period_us
        while packet.t_end_us - start >= period_us:
            count = min((packet.t_end_us - start) // period_us, _WINDOWS_AT_ONCE)
            edges = range(start, start + count * period_us + 1, period_us)
            places = packet.t.searchsorted(edges).tolist()
            for first, last, begin in zip(places, places[1:], edges, strict=False):
                yield packet.part(first, last, begin, begin + period_us)
            start = edges[-1]
        if packet.t_end_us > start:
            parts.append(_between(packet, start, start + period_us))
    if parts:
        yield _joined(parts, start, parts[-1].t_end_us)


def _between(packet: EventPacket, start_us: int, end_us: int) -> EventPacket:
    first, last = packet.t.searchsorted((start_us, end_us))
    span = max(start_us, packet.t_start_us), min(end_us, packet.t_end_us)
    return packet.part(int(first), int(last), *span)


def _joined(parts: list[EventPacket], start_us: int, end_us: int) -> EventPacket:
    if len(parts) == 1 and (parts[0].t_start_us, parts[0].t_end_us) == (start_us, end_us):
        return parts[0]
    kept = [part for part in parts if len(part)]
    if not kept:
        return EventPacket.empty(start_us, end_us, parts[0].size)
    whole = kept[0] if len(kept) == 1 else EventPacket.concatenate(kept)
    return whole.part(0, len(whole), start_us, end_us)
