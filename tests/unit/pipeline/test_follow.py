import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.pipeline.follow import EstimateTimes, follow
from spikingtac.types import EventPacket, LossCounters
from stand_ins.live import CountingTracker
from stand_ins.random_packets import packet_at

SIZE = (8, 8)


def packet(times_us: list[int], start_us: int, end_us: int) -> EventPacket:
    return packet_at(times_us, (start_us, end_us), SIZE)


def counts(packets: list[EventPacket], rate_hz: float) -> list[tuple[int, int]]:
    """Return the times of the estimates, and how many events had been seen then."""
    frames = follow(packets, CountingTracker(), rate_hz)
    return [(frame.t_us, int(frame.position_px[0, 0])) for frame in frames]


def test_estimates_follow_the_contracts_times() -> None:
    times = [EstimateTimes(400, 350.0).at(k) for k in range(4)]
    assert times == [400, 400 + 2857, 400 + 5714, 400 + 8571]


def test_silence_is_filled_and_the_start_is_the_first_event() -> None:
    stream = [packet([], 0, 500), packet([1_000, 1_500], 500, 2_000), packet([4_100], 2_000, 4_101)]
    assert counts(stream, 1_000.0) == [(1_000, 0), (2_000, 2), (3_000, 2), (4_000, 2)]


def test_any_packing_gives_the_same_estimates() -> None:
    rng = np.random.default_rng(2)
    times = np.sort(rng.integers(0, 50_000, 700)).tolist()
    whole = counts([packet(times, 0, 50_000)], 1_000.0)
    for _ in range(5):
        edges = [0, *sorted(rng.integers(1, 50_000, 9).tolist()), 50_000]
        parts = [
            packet([t for t in times if a <= t < b], a, b) for a, b in itertools.pairwise(edges)
        ]
        assert counts(parts, 1_000.0) == whole


def test_an_empty_recording_gives_nothing() -> None:
    assert counts([], 1_000.0) == []
    assert counts([EventPacket.empty(0, 9_000, SIZE)], 1_000.0) == []


@pytest.mark.parametrize("rate_hz", [0.0, -5.0, 2e6])
def test_unfit_rates_are_refused(rate_hz: float) -> None:
    with pytest.raises(ConfigError, match="rate_hz"):
        counts([packet([1], 0, 2)], rate_hz)


class Losing:
    """A source that loses something before its second packet."""

    size = SIZE

    def __init__(self) -> None:
        self.losses = LossCounters()

    def __iter__(self) -> Iterator[EventPacket]:
        yield packet([1_000, 1_500], 1_000, 3_000)
        self.losses.add("overflow", 7)
        self.losses.add("reconnected")
        yield packet([3_100], 3_000, 203_000)


def test_every_frame_carries_the_health_of_its_source() -> None:
    frames = list(follow(Losing(), CountingTracker(), 1_000.0))
    assert [frame.health.overflows for frame in frames[:2]] == [0, 0]
    assert (frames[-1].health.overflows, frames[-1].health.reconnects) == (7, 1)
    assert frames[-1].t_us == 203_000
    assert frames[-1].health.rate_ev_s == 0.0  # nothing came from 100 to 200 ms
    at_120_ms = next(frame for frame in frames if frame.t_us == 120_000)
    assert at_120_ms.health.rate_ev_s == pytest.approx(3 / 0.099)
