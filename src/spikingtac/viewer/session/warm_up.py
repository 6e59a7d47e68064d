"""Play a moment of nothing, so that everything is compiled and loaded before the real stream.

A simulated sensor compiles its kernels in a process of its own; rehearsing meanwhile, instead of
waiting for its first event, halves the first start.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.live.event_store import EventStore
from spikingtac.live.playback import Playback
from spikingtac.types import EventPacket
from spikingtac.viewer.session.snapshot import images, moving
from spikingtac.viewer.session.source import ViewSource

if TYPE_CHECKING:
    from spikingtac.sim.scene.scene import Scene

REHEARSED_US = 320_000
"""Long enough for a contact detector that learns from its first 0.3 s."""
PACKET_US = 10_000
BUDGET_S = 600.0
TOUCHED_S, TOUCH_STEP_S = 1.0, 0.02
"""A scene of ours touches within its first second; coarse steps, since nobody looks."""
EXPOSURE_US = 10_000


def warm_up(subject: ViewSource) -> None:
    """Track a nearly silent stream with a tracker of the subject's, and let go of both."""
    store = EventStore(PacketSource(list(_silence(subject.source.size)), subject.source.size))
    try:
        playback = Playback(
            store,
            lambda: subject.make_tracker(subject.config),
            subject.make_detector,
            rate_hz=subject.rate_hz,
        )
        playback.aim(REHEARSED_US)
        playback.work(BUDGET_S)
        moving(subject, playback)
        images(playback, EXPOSURE_US, None)
    finally:
        store.close()
    subject.prepare()


def touch_once(scene: Scene, seed: int) -> None:
    """Press a scene's first contact into a gel, so that the gel's kernels are in the cache.

    The camera's kernels take the simulated sensor's process as long as the tracker's and the gel's
    together take this one; where the sensor then reaches its first contact, it finds the gel's.
    """
    from spikingtac.sim.gel.gel import Gel
    from spikingtac.sim.scene.timeline import Timeline

    gel, timeline = Gel(scene.gel, scene.skin.rest_mm()), Timeline(scene, seed)
    for step in range(round(TOUCHED_S / TOUCH_STEP_S)):
        gel.step(TOUCH_STEP_S, *(timeline.at(step * TOUCH_STEP_S) or (None, None)))


def _silence(size: tuple[int, int]) -> Iterator[EventPacket]:
    """Yield two events in each packet: kernels are compiled by what they are called with."""
    x, y = (np.full(2, side // 2, np.uint16) for side in size)
    both = np.array([True, False])
    for start_us in range(0, REHEARSED_US + PACKET_US, PACKET_US):
        t_us = np.array([start_us, start_us + 1], np.int64)
        yield EventPacket(x, y, both, t_us, start_us, start_us + PACKET_US, size)
