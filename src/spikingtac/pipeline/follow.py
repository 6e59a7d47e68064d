"""The driver of every tracker: events in, marker frames at a regular rate out.

A source that it reads may be checked on the way: do the events fit the calibration?

It cuts the stream at the estimate times, so that estimates never depend on how the events were
packed. Times are data times; nothing here reads a clock.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, ConfigError, require_type
from spikingtac.events.source import EventSource, HealthMeter, refuse_path
from spikingtac.events.windows import stretches
from spikingtac.markers.calibration_check import CalibrationCheck
from spikingtac.markers.registry import MarkerTracker
from spikingtac.types import EventPacket, LossCounters, MarkerFrame

LARGEST_RATE_HZ = 1.0e6  # Events carry microseconds; no estimate can be asked for more often.


def follow(
    packets: Iterable[EventPacket],
    tracker: MarkerTracker,
    rate_hz: float,
    losses: MutableMapping[str, int] | None = None,
) -> Iterator[MarkerFrame]:
    """Track a stream and yield the markers at a regular rate.

    The first estimate is at the first event, the last one at most a period before the end of the
    stream. Silence in between is filled with estimates too, up to a minute. After a longer one (a
    leap of the clock) the estimates continue at the next event, at the same regular times.
    Every frame carries the health of the stream.

    Args:
        packets: Packets in order of time, of any length.
        tracker: Any tracker, freshly made or reset.
        rate_hz: Estimates per second of data time.
        losses: What their source counts, for the health; that of ``packets`` unless given. The
            tracker's ``hot_pixels`` and ``silences`` are counted there, too.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz, or a path is given instead of packets.
    """
    refuse_path(packets)
    require_type(tracker, MarkerTracker, "make_tracker(config, calibration)")
    check_rate(rate_hz)
    counted: MutableMapping[str, int] = getattr(packets, "losses", {}) if losses is None else losses
    meter = HealthMeter(counted)
    stream = iter(packets)
    first = next((packet.sound() for packet in stream if len(packet)), None)
    if first is None:
        return
    begun_us = int(first.t[0])
    times = EstimateTimes(begun_us, rate_hz)
    yield tracker.estimate(begun_us).with_health(meter.now())

    def absorb(packet: EventPacket) -> None:
        tracker.absorb(packet)
        meter.absorb(packet)
        for kind in ("hot_pixels", "silences"):
            if count := getattr(tracker, kind, 0):
                counted[kind] = count

    for stretch in stretches(itertools.chain([first.split(begun_us)[1]], stream)):
        index: int | None = None
        for packet in stretch:
            rest, index = packet, times.index(packet.t_start_us) if index is None else index
            while (due_us := times.at(index + 1)) <= rest.t_end_us:
                before, rest = rest.split(due_us)
                absorb(before)
                yield tracker.estimate(due_us).with_health(meter.now())
                index += 1
            absorb(rest)  # at once, so that little is left to do when the next estimate is due


@dataclass(frozen=True, slots=True)
class EstimateTimes:
    """The times ``t_k = first_us + floor(k * 1e6 / rate_hz)``, k = 0, 1, 2, ...

    Attributes:
        first_us: Time of the stream's first event, us.
        rate_hz: Estimates per second of data time.

    Example:
        >>> [EstimateTimes(400, 350.0).at(k) for k in range(3)]
        [400, 3257, 6114]
    """

    first_us: int
    rate_hz: float

    def __post_init__(self) -> None:
        check_rate(self.rate_hz)

    def at(self, index: int) -> int:
        """Return the time of an estimate, us."""
        return self.first_us + int(index * 1e6 // self.rate_hz)

    def index(self, t_us: int) -> int:
        """Return the index of the last time at or before ``t_us``, or 0."""
        index = max(int((t_us - self.first_us) * self.rate_hz / 1e6) - 1, 0)
        while self.at(index + 1) <= t_us:
            index += 1
        return index


def check_rate(rate_hz: float) -> None:
    """Refuse a rate at which no stream can be tracked.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz.
    """
    if not isinstance(rate_hz, Real) or not 0.0 < rate_hz <= LARGEST_RATE_HZ:
        raise ConfigError(f"rate_hz is {rate_hz!r}, it must be above 0 and at most 1e6")


class CheckedSource:
    """Passes packets on and compares them with a calibration meanwhile.

    Every attribute that is not named here is the source's own (``path``, ``progress``, ``close``).

    Args:
        source: Where the events come from.
        calibration: What they are tracked with.
        tell: Called once with a sentence where they contradict it; what it raises ends the stream.

    Attributes:
        misfit: That sentence, or None.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __init__(
        self,
        source: EventSource,
        calibration: Calibration,
        tell: Callable[[str], None] = lambda why: None,
    ) -> None:
        self._source, self._calibration, self._tell = source, calibration, tell
        self.misfit: str | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copies ask before there is a source
            raise AttributeError(name)
        return getattr(self._source, name)

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the source's packets."""
        check = CalibrationCheck(self._calibration)
        for packet in self._source:
            yield packet
            if not check.ended:  # after its use, which is urgent
                check.absorb(packet)
                self._judge(check)
        if not check.ended:
            check.finish()
            self._judge(check)

    def _judge(self, check: CalibrationCheck) -> None:
        if check.foreign and self.misfit is None:
            self.misfit = check.words()
            self._tell(self.misfit)


def refuse(why: str) -> None:
    """Refuse a calibration that does not fit.

    Raises:
        CalibrationError: Always, with the reason.
    """
    raise CalibrationError(why)
