"""A stored stream, and what is tracked of it forwards and after going back."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spikingtac.events.source import PacketSource
from spikingtac.pipeline.follow import follow
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer import playback as module
from spikingtac.viewer import source
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.source import EventStore
from stand_ins.live import SIZE, BurstDetector, CountingTracker, random_packets, random_source
from stand_ins.random_packets import assert_equal
from stand_ins.viewer import open_circling

FOREVER_S = 3600.0


def counted(store: EventStore, rate_hz: float, on_frame: Any = lambda _: None) -> Playback:
    view = replace(
        open_circling(10_000),
        make_tracker=lambda _: CountingTracker(),
        make_detector=BurstDetector,
        rate_hz=rate_hz,
    )
    return Playback(store, view, on_frame)


def playback() -> Playback:
    return counted(EventStore(random_source(seed=3, packets=60)), 1000.0)


def tracked_to(play: Playback, t_us: int) -> np.ndarray:
    play.aim(t_us)
    assert play.work(FOREVER_S)
    assert play.position_us == t_us
    return play.state.frame.detected_px


def test_going_back_gives_what_was_there_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_DISTANCE_US", 30_000)
    play = playback()
    start_us = play.store.t_start_us
    times = [start_us + ms * 1000 for ms in (10, 40, 95, 200, 480)]
    forwards = [tracked_to(play, t_us).copy() for t_us in times]
    for index in (3, 0, 4, 1, 2):
        np.testing.assert_array_equal(tracked_to(play, times[index]), forwards[index])


def leaping_source(leap_us: int) -> PacketSource:
    packets = random_packets(seed=3, packets=40)
    late = [
        replace(packet, t=packet.t + leap_us, t_start_us=start, t_end_us=packet.t_end_us + leap_us)
        for packet in packets[20:]
        for start in [packet.t_start_us + (leap_us if packet is not packets[20] else 0)]
    ]
    return PacketSource([*packets[:20], *late], SIZE)


@pytest.mark.parametrize("leap_us", [0, 30_000_000, 200_000_000, 8_000_000_000])
def test_estimates_are_those_of_follow_and_a_leap_of_the_clock_is_not_filled(leap_us: int) -> None:
    frames: list[MarkerFrame] = []
    rate_hz = 350.0 if leap_us else 3_000.0
    play = counted(EventStore(leaping_source(leap_us)), rate_hz, frames.append)
    play.aim(10**12)
    assert play.work(FOREVER_S)
    expected = list(follow(leaping_source(leap_us), CountingTracker(), rate_hz))
    assert [frame.t_us for frame in frames] == [frame.t_us for frame in expected]
    for one, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(one.detected_px, other.detected_px)
        assert one.health == other.health
    assert len(frames) < rate_hz * 62


def test_a_long_silence_can_be_visited_and_left_again() -> None:
    store = EventStore(leaping_source(8_000_000_000))
    store.extend_to(float("inf"))
    play = counted(store, 100.0)
    seen = {t_us: tracked_to(play, t_us).copy() for t_us in (100_000, 4_000_000_000)}
    play.aim(store.t_end_us)
    play.work(FOREVER_S)
    for t_us in (4_000_000_000, 100_000):
        np.testing.assert_array_equal(tracked_to(play, t_us), seen[t_us])


def test_few_copies_are_kept_of_a_large_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_DISTANCE_US", 10_000)
    monkeypatch.setattr(module, "MOST_PIXELS", 1)
    play = playback()
    first = tracked_to(play, 105_000).copy()
    tracked_to(play, 500_000)
    assert len(play._copies) <= 2
    np.testing.assert_array_equal(tracked_to(play, 105_000), first)


@pytest.mark.parametrize("capacity", [1, 7, 1 << 20])
def test_any_stretch_equals_the_source(capacity: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FIRST_CAPACITY", capacity)
    whole = EventPacket.concatenate(random_packets(1, 20))
    store = EventStore(random_source(1, 20))
    store.extend_to(10**9)
    for start_us, end_us in [(0, 10**9), (5_000, 5_001), (17_123, 90_001), (300_000, 400_000)]:
        part = store.between(start_us, end_us)
        assert_equal(part, whole.select((whole.t >= start_us) & (whole.t < end_us)))
        assert (part.t_start_us, part.t_end_us, part.size) == (start_us, end_us, SIZE)
    store.close()


def test_of_a_source_that_goes_on_the_latest_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "KEPT_US", 30_000)
    whole = EventPacket.concatenate(random_packets(3, 60))
    play = counted(EventStore(random_source(seed=3, packets=60), len(whole) // 3), 1000.0)
    first_us, last_us = play.store.t_start_us, play.store.t_start_us + 480_000
    np.testing.assert_array_equal(tracked_to(play, last_us), tracked_to(playback(), last_us))
    kept_us = play.store.kept_from_us
    assert first_us < kept_us <= last_us
    assert play.store.between(first_us, last_us).t.tolist() == [
        t for t in whole.t.tolist() if kept_us <= t < last_us
    ]
    play.aim(first_us)
    assert play.work(FOREVER_S)
    assert play.position_us == kept_us
