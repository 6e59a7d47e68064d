"""The paper's pipeline in one screen: events in, marker frames out.

One driver cuts the stream at the estimate times, so that estimates never depend on how the events
were packed. Times are data times; nothing here looks at a clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

from spikingtac.errors import ConfigError
from spikingtac.events.windows import cut
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import EventPacket, MarkerFrame

LARGEST_RATE_HZ = 1.0e6
"""Events carry microseconds; no estimate can be asked for more often."""


def estimate_times_us(first_us: int, rate_hz: float) -> Iterator[int]:
    """Yield t_k = first + floor(k * 1e6 / rate) without end.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz.
    """
    if not 0.0 < rate_hz <= LARGEST_RATE_HZ:
        raise ConfigError(f"rate_hz is {rate_hz:g}, it must be above 0 and at most 1e6")
    return (first_us + int(k * 1e6 // rate_hz) for k in itertools.count())


def follow(
    packets: Iterable[EventPacket], tracker: MarkerTracker, rate_hz: float
) -> Iterator[MarkerFrame]:
    """Track a stream and yield the markers at a regular rate.

    The first estimate is at the first event, the last one at most a period before the last event;
    silence in between is filled with estimates too.

    Args:
        packets: Packets in order of time, of any length.
        tracker: Any tracker, freshly made or reset.
        rate_hz: Estimates per second of data time.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz.
    """
    stream = iter(packets)
    first = next((packet for packet in stream if len(packet)), None)
    times_us = estimate_times_us(int(first.t[0]) if first else 0, rate_hz)
    if first is None:
        return
    yield tracker.estimate(int(first.t[0]))
    edges_us, wanted_us = itertools.tee(times_us)
    next(wanted_us)
    for window in cut(itertools.chain([first], stream), edges_us):
        tracker.absorb(window)
        if window.t_end_us == next(wanted_us):
            yield tracker.estimate(window.t_end_us)
