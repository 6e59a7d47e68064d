"""Cut a stream into regular windows, which keep the empty ones, since silence is data.

Silence is filled up to a limit. A stream whose time leaps by hours (a wrong timestamp, a clock that
was set) is not silent for hours, and filling the leap would never end: beyond the limit, windows
and estimates go on where the next event is. Sources count such leaps as ``time_jump``.
"""

import itertools
from collections.abc import Iterable, Iterator
from numbers import Integral

import numpy as np

from spikingtac.errors import ConfigError, require_type
from spikingtac.events.source import OPENED, refuse_path
from spikingtac.types import EventPacket

# Longest silence that is filled: a minute (a 320x320 sensor at rest sends events of noise
# within a second, and a minute of windows or estimates takes seconds, not hours).
SILENCE_LIMIT_US = 60_000_000

WINDOWS_AT_ONCE = 1000  # Windows whose edges are searched together in a packet.


def windows(
    packets: Iterable[EventPacket],
    period_us: int,
    t_start_us: int | None = None,
    silence_limit_us: int | None = SILENCE_LIMIT_US,
) -> Iterator[EventPacket]:
    """Yield regular half-open windows of ``period_us``, including the empty ones.

    After a silence beyond the limit the windows go on, on the same grid, at the next event.

    Args:
        packets: Packets in order of time, of any length.
        period_us: Length of a window, us.
        t_start_us: Where the first window begins; None begins at the first packet.
        silence_limit_us: Longest silence that is filled, us; None for a source that says what time
            it is, such as a simulation.

    Raises:
        ConfigError: The period is no positive whole number, a packet's columns do not fit its
            sensor, or something else is given instead of packets, such as a path.
    """
    refuse_path(packets)
    if not isinstance(period_us, Integral) or period_us < 1:
        raise ConfigError(f"period_us is {period_us!r}, it must be a whole number, at least 1")
    stream = iter(packets)
    first = next(stream, None)
    if first is None:
        return
    require_type(first, EventPacket, OPENED)
    origin = first.t_start_us if t_start_us is None else t_start_us
    pieces = _pieces(itertools.chain((first,), stream), silence_limit_us)
    yield from _regular(pieces, period_us, origin)


def stretches(
    packets: Iterable[EventPacket], silence_limit_us: int = SILENCE_LIMIT_US
) -> Iterator[Iterator[EventPacket]]:
    """Yield the stretches of a stream between silences beyond the limit, each as packets.

    A stretch ends the limit after its last event; the next one begins with its first event. How the
    stream was packed does not matter. Take the packets of a stretch before the next one.

    Args:
        packets: Packets in order of time, of any length.
        silence_limit_us: Longest silence within a stretch, us.

    Raises:
        ConfigError: A packet's columns do not fit its sensor.
    """
    pieces = _pieces(packets, silence_limit_us)
    for _, group in itertools.groupby(pieces, key=lambda piece: piece[0]):
        yield (packet for _, packet in group)


def _pieces(
    packets: Iterable[EventPacket], silence_limit_us: int | None
) -> Iterator[tuple[int, EventPacket]]:
    """Yield (number of the stretch, packet); packets end where too long a silence goes on."""
    number, last_us = 0, None
    for given in packets:
        packet = given.sound()
        if silence_limit_us is None:
            yield 0, packet
            continue
        if last_us is None:
            last_us = packet.t_start_us
        leaps: list[int] = []
        if packet.t_end_us - last_us > silence_limit_us:
            leaps = np.flatnonzero(np.diff(packet.t, prepend=last_us) > silence_limit_us).tolist()
        start_us, first = packet.t_start_us, 0
        for following in [*leaps, len(packet)]:
            if following > first:
                last_us = int(packet.t[following - 1])
            end_us = min(packet.t_end_us, last_us + silence_limit_us)
            if following < len(packet):
                end_us = min(end_us, int(packet.t[following]))
            if end_us > start_us:
                span = first, following, start_us, end_us
                whole = span == (0, len(packet), packet.t_start_us, packet.t_end_us)
                yield number, packet if whole else packet.part(*span)
            if following < len(packet):
                number, first = number + 1, following
                start_us = int(packet.t[following])


def _regular(
    pieces: Iterable[tuple[int, EventPacket]], period_us: int, origin: int
) -> Iterator[EventPacket]:
    """Yield the windows of a period, on one grid through all stretches."""
    parts: list[EventPacket] = []
    start, stretch = origin, 0
    for number, packet in pieces:
        begin = origin + (packet.t_start_us - origin) // period_us * period_us
        if number != stretch and begin > start:
            if parts:
                yield _joined(parts, start, start + period_us)
            parts, start = [], begin
        stretch = number
        if parts and packet.t_end_us - start >= period_us:
            parts.append(_between(packet, start, start + period_us))
            yield _joined(parts, start, start + period_us)
            parts, start = [], start + period_us
        while packet.t_end_us - start >= period_us:
            edges = range(start, packet.t_end_us + 1, period_us)[: WINDOWS_AT_ONCE + 1]
            places = packet.t.searchsorted(edges).tolist()
            for begin, (first, last) in zip(edges, itertools.pairwise(places), strict=False):
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
