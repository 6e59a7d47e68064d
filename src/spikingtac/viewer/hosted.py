"""The loop of a session, in a process of its own or without any page: open, warm up, play."""

from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.events.source import PacketSource
from spikingtac.stream.host import Asker, Factory
from spikingtac.stream.real_time import meet_deadlines
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket
from spikingtac.viewer.replay.event_store import EventStore
from spikingtac.viewer.replay.playback import Playback
from spikingtac.viewer.session import Session
from spikingtac.viewer.snapshot import images, moving, starting
from spikingtac.viewer.source import ViewSource
from spikingtac.viewer.web.wire import STOP

# Longest time to complete the tracks once the asker is gone, s; an idle machine needs 0.1 s.
COMPLETE_S = 20.0

# Objects made between two collections of garbage. Python's 700 or 2,000 cost 5 to 10 % of the
# time that compiling takes; 10,000 cost 10 MiB (measured).
COLLECT_AFTER = 10_000

# Stretch of silence that is tracked first, us: long enough for a contact detector that learns
# from the first 0.3 s.
WARM_UP_US = 320_000
PACKET_US = 10_000
BUDGET_S = 600.0


def run_session(
    asker: Asker, open_view: Factory[ViewSource], options: dict[str, Any], rings: tuple[str, str]
) -> None:
    """Open a view and play it until the asker ends it, who is told the summary.

    Args:
        asker: Sends commands, and is told of an error.
        open_view: Opens what is viewed.
        options: ``repeat``, ``realtime``; ``tracks`` and ``picture``, files or None.
        rings: Names of the rings for frames and greetings.

    Raises:
        SpikingTacError: The view could not be opened, or failed.
    """
    asker.grace_s = COMPLETE_S
    frames = SharedRing.attach(rings[0])
    greetings = SharedRing.attach(rings[1])
    gc.freeze()  # compiling makes much garbage, and each collection would visit all imports
    gc.set_threshold(COLLECT_AFTER)
    view = open_view()
    greetings.publish(json.dumps(starting(view)).encode())
    warm_up(view)
    if options["realtime"]:
        view = replace(view, notice=f"{view.notice} {meet_deadlines().text()}".strip())
    play = partial(Session, frames=frames, greetings=greetings, repeat=options["repeat"])
    session = play(view, tracks=options["tracks"])
    session = _serve(session, asker, partial(_another, play, greetings))
    _complete(session, options["picture"], asker.tell)


def show_headless(
    view: ViewSource,
    seconds: float,
    *,
    tracks: Path | None = None,
    picture: Path | None = None,
    realtime: bool = False,
) -> dict[str, Any]:
    """Play a live source without a page, for some seconds or until it ends, and return figures.

    Args:
        view: A camera or a scene.
        seconds: Length, s, from the first events on.
        tracks: File for every estimate, or None.
        picture: File for the summary picture, or None.
        realtime: Ask for what helps to keep deadlines.

    Raises:
        SpikingTacError: The source failed, or nothing was shown and a picture is asked for.
    """
    warm_up(view)
    if realtime:
        meet_deadlines()
    session = Session(view, _Nowhere(), _Nowhere(), tracks=tracks)
    until_s = time.monotonic() + seconds
    with suppress(KeyboardInterrupt):
        while time.monotonic() < until_s and session.playing and session.failure is None:
            session.step()
    told: list[dict[str, Any]] = []
    _complete(session, picture, told.append)
    return told[0]


def _complete(session: Session, picture: Path | None, tell: Callable[[Any], object]) -> None:
    """Complete the files, and tell the summary.

    Raises:
        Exception: What ended a live source; the files are complete.
    """
    session.close(lambda: tell(session.summary(picture)))
    if session.failure is not None:
        raise session.failure


def _serve(session: Session, asker: Asker, another: Callable[[Session, str], Session]) -> Session:
    """Play until the end is asked for; return the session that is played then."""
    while not asker.gone.is_set():
        for name, value in _latest(asker.said()):
            if name == STOP[0]:
                return session
            if name == "open":
                session = another(session, value)
            else:
                session.command(name, value)
        session.step()
    return session


def _another(
    play: Callable[[ViewSource], Session], greetings: SharedRing, session: Session, name: str
) -> Session:
    """Return the session of another recording; where it cannot be opened, the present one."""
    try:
        shelf = session.view.shelf
        if shelf is None:
            raise ConfigError("other recordings can be opened where `view` was given one of a file")
        view = shelf.open(name)
        greetings.publish(json.dumps(starting(view)).encode())
        following = play(view)
    except (SpikingTacError, OSError) as error:
        session.warn(str(error))
        return session
    session.close()
    return following


def _latest(commands: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Return commands; of a dragged slider or timeline only the last position."""
    latest = {(name, value[0] if name == "set" else None): value for name, value in commands}
    return [(name, value) for (name, _), value in latest.items()]


class _Nowhere:
    """A publisher without readers."""

    def publish(self, message: bytes, /) -> bool:
        return bool(message)


def warm_up(view: ViewSource) -> None:
    """Track a nearly silent stream with a tracker of the view's, and discard both.

    A simulated sensor compiles its kernels in a process of its own. Compiling those of the tracker
    meanwhile, instead of waiting for the first event, halves the time of the first start.
    """
    store = EventStore(PacketSource(list(_silence(view.source.size)), view.source.size))
    try:
        make_tracker = partial(view.make_tracker, view.config)
        playback = Playback(store, make_tracker, view.make_detector, rate_hz=view.rate_hz)
        playback.aim(WARM_UP_US)
        playback.work(BUDGET_S)
        moving(view, playback)
        images(playback, PACKET_US, None)
    finally:
        store.close()


def _silence(size: tuple[int, int]) -> Iterator[EventPacket]:
    """Yield two events in each packet: kernels are compiled by what they are called with."""
    x, y = (np.full(2, side // 2, np.uint16) for side in size)
    both = np.array([True, False])
    for start_us in range(0, WARM_UP_US + PACKET_US, PACKET_US):
        t_us = np.array([start_us, start_us + 1], np.int64)
        yield EventPacket(x, y, both, t_us, start_us, start_us + PACKET_US, size)
