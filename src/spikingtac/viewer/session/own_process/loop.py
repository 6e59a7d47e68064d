"""The loop of a session, in a process of its own."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.stream.host import Asker, Factory
from spikingtac.stream.real_time import meet_deadlines
from spikingtac.stream.ring import SharedRing
from spikingtac.viewer.session.own_process.warm_up import warm_up
from spikingtac.viewer.session.session import Session
from spikingtac.viewer.session.snapshot import starting
from spikingtac.viewer.session.source import Recordings, ViewSource
from spikingtac.viewer.session.track_recorder import (
    FileTrackRecorder,
    NullTrackRecorder,
    TrackRecorder,
)
from spikingtac.viewer.session.wire import FRAME_BYTES, GREETING_BYTES, STOP

COMPLETE_S = 20.0
"""Longest time to complete the tracks once the asker is gone, s; an idle machine needs 0.1 s."""
COLLECT_AFTER = 10_000
"""Objects made between two collections of garbage. Python's 700 or 2,000 cost 5 to 10 % of the time
that compiling takes; 10,000 cost 10 MiB (measured)."""


def run_session(
    asker: Asker, open_view: Factory[ViewSource], options: dict[str, Any], rings: tuple[str, str]
) -> None:
    """Open a view and play it until the asker ends it.

    Args:
        asker: Sends commands, and is told of an error.
        open_view: Opens what is viewed.
        options: ``repeat``, ``realtime``, and ``tracks``, a file or None.
        rings: Names of the rings for frames and greetings.

    Raises:
        SpikingTacError: The view could not be opened, or failed.
    """
    asker.grace_s = COMPLETE_S
    frames = SharedRing.attach(rings[0], FRAME_BYTES)
    greetings = SharedRing.attach(rings[1], GREETING_BYTES)
    gc.freeze()  # compiling makes much garbage, and each collection would visit all imports
    gc.set_threshold(COLLECT_AFTER)
    view = open_view()
    greetings.publish(json.dumps(starting(view)).encode())
    warm_up(view)
    if options["realtime"]:
        view = replace(view, notice=f"{view.notice} {meet_deadlines().text()}".strip())
    recorder = _recorder(options["tracks"], view)
    play = partial(Session, frames=frames, greetings=greetings, repeat=options["repeat"])
    session = play(view, recorder=recorder)
    session = _serve(session, asker, partial(_another, view.shelf, play, greetings))
    session.close()
    if session.failure is not None:
        raise session.failure


def _recorder(tracks: Path | None, view: ViewSource) -> TrackRecorder:
    if tracks is None:
        return NullTrackRecorder()
    return FileTrackRecorder(tracks, view.calibration.reference_px)


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
    shelf: Recordings | None,
    play: Callable[[ViewSource], Session],
    greetings: SharedRing,
    session: Session,
    name: str,
) -> Session:
    """Return the session of another recording; where it cannot be opened, the present one."""
    try:
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
    return list(
        {
            (name, value[0] if name == "set" else None): (name, value) for name, value in commands
        }.values()
    )
