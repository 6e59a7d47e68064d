"""A session's life in a process of its own: open, warm up, play."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from spikingtac.events.source import PacketSource
from spikingtac.stream.host import Asker, Factory
from spikingtac.stream.real_time import meet_deadlines
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket
from spikingtac.viewer.event_store import EventStore
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.session import Session
from spikingtac.viewer.snapshot import images, moving, starting
from spikingtac.viewer.source import ViewSource
from spikingtac.viewer.wire import STOP

# Longest time to complete the tracks once the asker is gone, s; an idle machine needs 0.1 s.
COMPLETE_S = 20.0

# Stretch of silence that is tracked first, us: long enough for a contact detector that learns
# from the first 0.3 s.
WARM_UP_US = 320_000
PACKET_US = 10_000
BUDGET_S = 600.0  # Time for the compilation of all kernels, s.


def run_session(
    asker: Asker, open_view: Factory[ViewSource], options: dict[str, Any], rings: tuple[str, str]
) -> None:
    """Open a view and play it until the asker ends it, who is told the summary.

    Args:
        asker: Sends commands, and is told of an error.
        open_view: Opens what is viewed.
        options: ``repeat``, ``realtime``; ``picture``, a file or None.
        rings: Names of the rings for frames and greetings.

    Raises:
        SpikingTacError: The view could not be opened, or failed.
    """
    asker.grace_s = COMPLETE_S
    frames, greetings = (SharedRing.attach(name) for name in rings)
    view = open_view()
    greetings.publish(json.dumps(starting(view)).encode())
    warm_up(view)
    granted = meet_deadlines() if options["realtime"] else ""
    session = Session(view, frames, greetings, repeat=options["repeat"])
    session.warn(granted)
    while not asker.gone.is_set():
        # Of a dragged slider or timeline only the last position counts.
        said = {(name, value[0] if name == "set" else None): value for name, value in asker.said()}
        if STOP in said:
            break
        for (name, _), value in said.items():
            session.command(name, value)
        session.step()
        session.rest()
    asker.tell(session.close(options["picture"]))
    if session.failure is not None:
        raise session.failure


def warm_up(view: ViewSource) -> None:
    """Track a nearly silent stream with a tracker of the view's, and discard both.

    A simulated sensor compiles its kernels in a process of its own. Compiling those of the tracker
    meanwhile, instead of waiting for the first event, halves the time of the first start.
    """
    store = EventStore(PacketSource(list(_silence(view.source.size)), view.source.size))
    try:
        playback = Playback(store, view)
        playback.aim(WARM_UP_US)
        playback.work(BUDGET_S)
        moving(view, playback)
        images(playback, PACKET_US, False)
    finally:
        store.close()


def _silence(size: tuple[int, int]) -> Iterator[EventPacket]:
    """Yield two events in each packet: kernels are compiled by what they are called with."""
    x, y = (np.full(2, side // 2, np.uint16) for side in size)
    both = np.array([True, False])
    for start_us in range(0, WARM_UP_US + PACKET_US, PACKET_US):
        t_us = np.array([start_us, start_us + 1], np.int64)
        yield EventPacket(x, y, both, t_us, start_us, start_us + PACKET_US, size)
