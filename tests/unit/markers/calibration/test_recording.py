"""A recording in memory is read again as it came; rests are told by the rate of the events."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.recording import buffer_events, find_rests, flicker_hz
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
        assert [one.t_end_us for one in packets[:-1]] == [one.t_start_us for one in packets[1:]]
        assert source.size == SIZE


def test_motion_between_two_rests_and_flicker() -> None:
    rng, ends_us = np.random.default_rng(0), (0, 1_000_000, 2_000_000, 3_000_000)
    parts = [
        rng.integers(begin, end, rng.poisson(rate))
        for (begin, end), rate in zip(pairwise(ends_us), (2_000, 200_000, 2_000), strict=True)
    ]
    t = np.sort(np.concatenate(parts))
    one = np.ones(len(t), np.uint16)
    whole = EventPacket(one, one, one.astype(bool), t, 0, ends_us[-1], SIZE)
    events = buffer_events(PacketSource([whole], SIZE))
    rests_us = find_rests(events)
    np.testing.assert_allclose(rests_us, [[0, 1_000_000], [2_000_000, 3_000_000]], atol=30_000)
    assert flicker_hz(events) is None
    turns = replace(whole, p=t % 10_000 < 5_000)
    assert flicker_hz(buffer_events(PacketSource([turns], SIZE))) == 100.0
