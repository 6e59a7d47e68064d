"""Buffered events can be read again as they came: same events, same times, no gap."""

from __future__ import annotations

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.buffered_events import BufferedSource, buffer_events
from spikingtac.types import EventPacket

SIZE = (30, 20)


def test_what_was_buffered_is_read_again() -> None:
    rng = np.random.default_rng(5)
    t = np.sort(rng.integers(7_000, 95_000, 3_000))
    x, y = (rng.integers(0, side, len(t)).astype(np.uint16) for side in SIZE)
    whole = EventPacket(x, y, rng.random(len(t)) < 0.5, t, 7_000, 95_000, SIZE)
    source = BufferedSource(buffer_events(PacketSource([whole], SIZE), 10_000))
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
