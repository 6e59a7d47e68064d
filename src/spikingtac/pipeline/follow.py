"""The paper's pipeline in one screen: events in, marker frames out.

One driver cuts the stream at the estimate times, so that estimates never depend on how the events
were packed. Times are data times; nothing here reads a clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping

from spikingtac.events.source import refuse_path
from spikingtac.events.source_health import HealthMeter
from spikingtac.events.windows import cut, stretches
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.pipeline.estimate_times import EstimateTimes, check_rate
from spikingtac.types import EventPacket, MarkerFrame


def follow(
    packets: Iterable[EventPacket],
    tracker: MarkerTracker,
    rate_hz: float,
    losses: Mapping[str, int] | None = None,
    origin_us: int | None = None,
) -> Iterator[MarkerFrame]:
    """Track a stream and yield the markers at a regular rate.

    The first estimate is at the first event, the last one at most a period before the end of the
    stream. Silence in between is filled with estimates too, up to a minute: after a longer one (a
    leap of the clock) the estimates continue at the next event, at the same regular times.
    Every frame carries the health of the stream.

    Args:
        packets: Packets in order of time, of any length.
        tracker: Any tracker, freshly made or reset.
        rate_hz: Estimates per second of data time.
        losses: What their source counts, for the health; that of ``packets`` unless given.
        origin_us: Time of the first estimate of the recording that ``packets`` are a part of, us:
            the part is estimated at the same times as the whole.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz, or a path is given instead of packets.
    """
    refuse_path(packets)
    check_rate(rate_hz)
    meter = HealthMeter(getattr(packets, "losses", {}) if losses is None else losses)
    stream = iter(packets)
    first = next((packet for packet in stream if len(packet)), None)
    if first is None:
        return
    begun_us = int(first.t[0])
    times = EstimateTimes(begun_us if origin_us is None else origin_us, rate_hz)
    yield tracker.estimate(times.at(times.index(begun_us))).with_health(meter.now())
    for stretch in stretches(itertools.chain([first], stream)):
        begun = next(stretch)
        edges_us = times.since(begun.t_start_us)
        for window in cut(itertools.chain([begun], stretch), edges_us):
            tracker.absorb(window)
            meter.absorb(window)
            if times.includes(window.t_end_us):
                yield tracker.estimate(window.t_end_us).with_health(meter.now())
