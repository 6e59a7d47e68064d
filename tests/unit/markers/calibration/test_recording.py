"""A recording in memory is read again as it came; rests are told by the rate of the events."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.recording import buffer_events, find_rests, flicker_hz
from spikingtac.types import EventPacket

SIZE = (30, 20)


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
