"""The loop of a session, in a process of its own."""

from __future__ import annotations

import gc
import json
import multiprocessing
import queue
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.live.factory import Factory
from spikingtac.live.real_time import meet_deadlines
from spikingtac.live.ring import SharedRing
from spikingtac.viewer.session.own_process.warm_up import warm_up
from spikingtac.viewer.session.session import Session
from spikingtac.viewer.session.snapshot import starting
from spikingtac.viewer.session.source import Recordings, ViewSource
from spikingtac.viewer.session.track_recorder import (
    FileTrackRecorder,
    NullTrackRecorder,
    TrackRecorder,
)
from spikingtac.viewer.session.wire import FRAME_BYTES, GREETING_BYTES

COLLECT_AFTER = 10_000
"""Objects made between two collections of garbage. Python's 700 or 2,000 cost 5 to 10 % of the time
that compiling takes; 10,000 cost 10 MiB (measured)."""


def run_session(open_view: Factory[ViewSource], options: dict[str, Any], channels: Any) -> None:
    """Open a view and play it until the parent ends it; an error goes to the parent.

    Args:
        open_view: Opens what is viewed.
        options: ``repeat``, ``realtime``, and ``tracks``, a file or None.
        channels: Names of the rings for frames and greetings; queues of commands and failures; the
            event that ends it.

    Raises:
        SystemExit: The view could not be opened, or failed.
    """
    # Ctrl-C reaches the whole terminal group; the parent decides when this process ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    (frames_name, greetings_name), commands, failures, stopped = channels
    frames = SharedRing.attach(frames_name, FRAME_BYTES)
    greetings = SharedRing.attach(greetings_name, GREETING_BYTES)
    gc.freeze()  # compiling makes much garbage, and each collection would visit all imports
    gc.set_threshold(COLLECT_AFTER)
    try:
        view = open_view()
        greetings.publish(json.dumps(starting(view)).encode())
        warm_up(view)
        if options["realtime"]:
            view = replace(view, notice=f"{view.notice} {meet_deadlines().text()}".strip())
        recorder = _recorder(options["tracks"], view)
        play = partial(Session, frames=frames, greetings=greetings, repeat=options["repeat"])
        session = play(view, recorder=recorder)
        another = partial(_another, view.shelf, play, greetings)
        session = _serve(session, commands, stopped, another)
        session.close()
        if session.failure is not None:
            raise session.failure
    except Exception as error:  # sent to the parent, which reports it
        failures.put(_portable(error))
        raise SystemExit(1) from error
    finally:
        frames.close()
        greetings.close()


def _recorder(tracks: Path | None, view: ViewSource) -> TrackRecorder:
    if tracks is None:
        return NullTrackRecorder()
    return FileTrackRecorder(tracks, view.calibration.reference_px)


def _serve(
    session: Session, commands: Any, stopped: Event, another: Callable[[Session, str], Session]
) -> Session:
    """Play until the end is asked for; return the session that is played then."""
    parent = multiprocessing.parent_process()
    while not stopped.is_set() and (parent is None or parent.is_alive()):
        for name, value in _waiting(commands):
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


def _waiting(commands: Any) -> list[tuple[str, Any]]:
    """Return the waiting commands; of a dragged slider or timeline only the last position."""
    latest: dict[tuple[str, Any], tuple[str, Any]] = {}
    while True:
        try:
            name, value = commands.get_nowait()
        except queue.Empty:
            return list(latest.values())
        latest[(name, value[0] if name == "set" else None)] = (name, value)


def _portable(error: Exception) -> Exception:
    """Return an error that can be sent to another process."""
    if isinstance(error, SpikingTacError | OSError):
        return error
    return RuntimeError(f"{type(error).__name__}: {error}")
