"""Track a short silent stream, so that all kernels are compiled before the real stream begins.

A simulated sensor compiles its kernels in a process of its own. Warming up meanwhile, instead of
waiting for its first event, halves the time of the first start.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.types import EventPacket
from spikingtac.viewer.event_store import EventStore
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.session.snapshot import images, moving
from spikingtac.viewer.session.source import ViewSource

WARM_UP_US = 320_000
"""Long enough for a contact detector that learns from the first 0.3 s."""
PACKET_US = 10_000
BUDGET_S = 600.0
EXPOSURE_US = 10_000


def warm_up(view: ViewSource) -> None:
    """Track a nearly silent stream with a tracker of the view's, and discard both."""
    store = EventStore(PacketSource(list(_silence(view.source.size)), view.source.size))
    try:
        playback = Playback(
            store,
            lambda: view.make_tracker(view.config),
            view.make_detector,
            rate_hz=view.rate_hz,
        )
        playback.aim(WARM_UP_US)
        playback.work(BUDGET_S)
        moving(view, playback)
        images(playback, EXPOSURE_US, None)
    finally:
        store.close()


def _silence(size: tuple[int, int]) -> Iterator[EventPacket]:
    """Yield two events in each packet: kernels are compiled by what they are called with."""
    x, y = (np.full(2, side // 2, np.uint16) for side in size)
    both = np.array([True, False])
    for start_us in range(0, WARM_UP_US + PACKET_US, PACKET_US):
        t_us = np.array([start_us, start_us + 1], np.int64)
        yield EventPacket(x, y, both, t_us, start_us, start_us + PACKET_US, size)
