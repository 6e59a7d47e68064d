"""A recording in memory is read again as it came; rests are told by the rate of the events."""

import numpy as np
import pytest

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.recording import RestWatch, buffer_events
from spikingtac.types import EventPacket

SIZE = (30, 20)


def test_what_was_buffered_is_read_again() -> None:
    rng = np.random.default_rng(5)
    t = np.sort(rng.integers(7_000, 95_000, 3_000))
    x, y = (rng.integers(0, side, len(t)).astype(np.uint16) for side in SIZE)
    whole = EventPacket(x, y, rng.random(len(t)) < 0.5, t, 7_000, 95_000, SIZE)
    source = buffer_events(PacketSource([whole], SIZE))
    for _ in range(2):  # as often as is wanted
        packets = list(source)
        for name in "xypt":
            again = np.concatenate([getattr(packet, name) for packet in packets])
            np.testing.assert_array_equal(again, getattr(whole, name))
        assert packets[0].t_start_us == 7_000
        assert packets[-1].t_end_us == 95_000
        ends = [packet.t_end_us for packet in packets]
        assert [packet.t_start_us for packet in packets[1:]] == ends[:-1]
        assert source.size == SIZE


def packet(begin_us: int, end_us: int, rate_hz: float, seed: int = 0) -> EventPacket:
    rng = np.random.default_rng([seed, begin_us])
    count = rng.poisson(rate_hz * (end_us - begin_us) / 1e6)
    t = np.sort(rng.integers(begin_us, end_us, count))
    one = np.ones(count, np.uint16)
    return EventPacket(one, one, one.astype(bool), t, begin_us, end_us, SIZE)


def fed(*stretches: tuple[float, float], packet_us: int) -> tuple[RestWatch, list[bool]]:
    """Feed stretches of (seconds, events per second); return whether each ended in a rest."""
    watch, resting, now = RestWatch(), [], 5_000
    for lasting_s, rate_hz in stretches:
        end = now + int(lasting_s * 1e6)
        while now < end:
            step = min(packet_us, end - now)
            watch.absorb(packet(now, now + step, rate_hz))
            now += step
        resting.append(watch.resting)
    return watch, resting


@pytest.mark.parametrize("packet_us", [1_000, 33_000, 400_000])
def test_motion_between_two_rests(packet_us: int) -> None:
    watch, resting = fed((1.0, 2_000), (1.0, 200_000), (1.0, 2_000), packet_us=packet_us)
    assert resting == [True, False, True]
    assert watch.rests == 2
