"""Open views in processes of their own, serve their page, and return what was shown at the end.

A busy thread beside the tracking loop would stretch a step of half a millisecond to several, since
threads share one interpreter lock. Each session therefore runs in another process than the server.
"""

from __future__ import annotations

import json
import os
import socket
import time
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import DeviceError
from spikingtac.events.source import PacketSource
from spikingtac.stream.host import Asker, Host, closed_by
from spikingtac.stream.real_time import meet_deadlines
from spikingtac.stream.ring import SharedRing
from spikingtac.types import EventPacket
from spikingtac.viewer.access import Gate, listen
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.server import PageServer, serve
from spikingtac.viewer.session import Session
from spikingtac.viewer.snapshot import FRAME_BYTES, GREETING_BYTES, images, moving, starting
from spikingtac.viewer.source import EventStore, ViewSource

STILL_STARTING_S = 15.0  # How often the user reads that the first start goes on, s.
WAIT_S = 0.02  # Time between two looks for a view that is being opened, s.

# Longest wait for a session to complete its tracks, s; an idle machine needs 0.1 s.
SHUTDOWN_S = 20.0
LOOK_S = 0.1  # Longest wait for a word of the session, s.

STOP = ("stop", None)  # The last command of a session; pages cannot send it.

# Stretch of silence that is tracked first, us: long enough for a contact detector that learns
# from the first 0.3 s.
WARM_UP_US = 320_000
PACKET_US = 10_000
BUDGET_S = 600.0  # Time for the compilation of all kernels, s.

# Nice value of the server: a third of an ordinary program's share on a busy machine.
NICENESS = 5


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """How a page is served.

    Attributes:
        host: Address to bind to.
        port: Port, or 0 for any free one.
        browser: Open the user's browser.
        seconds: End after so long, s, or None for never.
        repeat: Begin again at the end.
        picture: File for the summary picture, or None.
        realtime: Whether the session asks for what helps to keep deadlines.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    browser: bool = True
    seconds: float | None = None
    repeat: bool = False
    picture: Path | None = None
    realtime: bool = False


class SessionProcess:
    """Starts a session in a process of its own and reads its latest frames.

    Args:
        open_view: Opens what is viewed, in the session's process.
        options: Whether to repeat it and to ask for deadlines; a picture is whole once
            :meth:`stop` has returned.
    """

    def __init__(
        self, open_view: Callable[[], ViewSource], options: PageOptions = PageOptions()
    ) -> None:
        self._rings = [SharedRing.for_latest(size) for size in (FRAME_BYTES, GREETING_BYTES)]
        frames, greetings = self._rings
        # The latest message with its number, or None if there is none newer than a number.
        self.frame, self.greeting = frames.latest, greetings.latest
        given = {"open_view": open_view, "options": options, "rings": (frames.name, greetings.name)}
        self._host = Host(partial(run_session, **given))

    def command(self, name: str, value: Any) -> None:
        """Pass a command on; never waits, and loses one that the session does not take."""
        self._host.tell((name, value))

    @property
    def alive(self) -> bool:
        """True while the process runs."""
        return self._host.alive()

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._host.pid

    def require_alive(self) -> None:
        """Raise what ended the session, if it has ended: it ends only when it is told to."""
        alive = self.alive  # asked first: a failure is sent before the process ends
        try:
            self._host.receive()
        except EOFError:
            alive = not self._host.wait(SHUTDOWN_S)
        if not alive:
            raise closed_by(self._host, "the page")

    def stop(self) -> dict[str, Any] | None:
        """Stop the process, and return the summary of what was shown; None where it hangs.

        Raises:
            Exception: What the session failed with.
        """
        summary = None
        if self._host.tell(STOP):
            until_s = time.monotonic() + SHUTDOWN_S
            with suppress(EOFError):
                while time.monotonic() < until_s:
                    summary = self._host.receive(LOOK_S) or summary
            self._host.wait(SHUTDOWN_S)
        return summary

    def close(self) -> None:
        """Stop the process and release the shared memory."""
        try:
            with suppress(Exception):  # it was told where it mattered
                self.stop()
        finally:  # also where a second Ctrl-C cuts the wait short
            for one in (self._host, *self._rings):
                one.close()


def run_session(
    asker: Asker, open_view: Callable[[], ViewSource], options: PageOptions, rings: tuple[str, str]
) -> None:
    """Open a view and play it until the asker ends it, who is told the summary.

    Args:
        asker: Sends commands, and is told of an error.
        open_view: Opens what is viewed.
        options: Whether to repeat it and to ask for deadlines, and a file for a picture.
        rings: Names of the rings for frames and greetings.

    Raises:
        SpikingTacError: The view could not be opened, or failed.
    """
    asker.grace_s = SHUTDOWN_S
    frames, greetings = (SharedRing.attach(name) for name in rings)
    view = open_view()
    greetings.publish(json.dumps(starting(view)).encode())
    warm_up(view)
    granted = meet_deadlines() if options.realtime else ""
    session = Session(view, frames, greetings, repeat=options.repeat)
    session.warn(granted)
    try:
        while not asker.gone.is_set():
            # Of a dragged slider or timeline only the last position counts.
            said = {(name, name == "set" and value[0]): value for name, value in asker.said()}
            if (STOP[0], False) in said:
                break
            for (name, _), value in said.items():
                session.command(name, value)
            session.step()
            session.rest()
        if options.picture is not None:
            session.record.save_picture(options.picture, session.playback)
        asker.tell(session.record.summary(session.playback))
    finally:
        session.close()
    if session.failure is not None:
        raise session.failure


def warm_up(view: ViewSource) -> None:
    """Track a nearly silent stream with a tracker of the view's, and discard both.

    A simulated sensor compiles its kernels in a process of its own. Compiling those of the tracker
    meanwhile, instead of waiting for the first event, halves the time of the first start.
    """
    size, silence = view.source.size, []
    for start_us in range(0, WARM_UP_US + PACKET_US, PACKET_US):
        # Two events in each packet: kernels are compiled by what they are called with.
        x, y = (np.full(2, side // 2, np.uint16) for side in size)
        t_us, both = np.array([start_us, start_us + 1], np.int64), np.array([True, False])
        silence.append(EventPacket(x, y, both, t_us, start_us, start_us + PACKET_US, size))
    store = EventStore(PacketSource(silence, size))
    try:
        playback = Playback(store, view)
        playback.aim(WARM_UP_US)
        playback.work(BUDGET_S)
        moving(playback)
        images(playback, PACKET_US, False)
    finally:
        store.close()


def show(
    open_views: Sequence[Callable[[], ViewSource]],
    options: PageOptions,
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Serve one view, or two side by side, until interrupted or until the time is up.

    Args:
        open_views: Open the views, each in a session's process.
        options: How the page is served; a picture is that of a single view.
        report: Takes the lines for the user.

    Returns:
        The summary of the first view; that of another one is its ``second``.

    Raises:
        SpikingTacError: A view cannot be opened, a file cannot be written, the port is taken, or a
            session was killed.
    """
    listening = listen(options.host, options.port)
    sessions = [SessionProcess(view, options) for view in open_views]
    try:
        _serve(sessions, options, report, listening)
        summaries = [session.stop() for session in sessions]
    finally:
        listening.close()
        for session in sessions:
            session.close()
    first, *others = summaries
    if first is None or None in others:
        raise DeviceError(
            f"the session did not end within {SHUTDOWN_S:g} s and was killed; nothing is known of "
            "what it showed"
        )
    written = {} if options.picture is None else {"picture": str(options.picture)}
    return first | written | ({"second": others[0]} if others else {})


def _serve(
    sessions: Sequence[SessionProcess],
    options: PageOptions,
    report: Callable[[str], None],
    listening: socket.socket,
) -> None:
    gate = Gate.for_host(options.host)
    life = _life(sessions, options.seconds or float("inf"), report)
    while not all(session.greeting(0) for session in sessions):  # no page without a view
        next(life)
        time.sleep(WAIT_S)
    if hasattr(os, "nice"):  # a busy machine runs the sessions first, which have started
        os.nice(NICENESS)

    def ready() -> None:
        port, query = listening.getsockname()[1], f"?token={gate.token}" if gate.token else ""
        host = f"[{options.host}]" if ":" in options.host else options.host
        here = f"http://127.0.0.1:{port}/{query}"
        report(f"open http://{host}:{port}/{query} (Ctrl-C ends)")
        report(f"from another machine: ssh -N -L {port}:127.0.0.1:{port} THIS_MACHINE, then {here}")
        if options.browser:
            webbrowser.open(here)

    serve(PageServer(sessions, gate), listening, lambda: next(life, False), ready)
    for session in sessions:
        session.require_alive()


def _life(
    sessions: Sequence[SessionProcess], seconds: float, report: Callable[[str], None]
) -> Iterator[bool]:
    """Yield True until a session has ended, or the viewing time, in which compiling does not count.

    Raises:
        Exception: What ended a session before its first frame.
    """
    begun_s = told_s = time.monotonic()
    while not all(session.frame(0) for session in sessions):
        for session in sessions:
            session.require_alive()
        if time.monotonic() - told_s > STILL_STARTING_S:
            told_s = time.monotonic()
            report(
                "getting ready: the first start compiles kernels, and a camera has to send "
                f"its first events ({told_s - begun_s:.0f} s so far)"
            )
        yield True
    until_s = time.monotonic() + seconds
    while all(session.alive for session in sessions) and time.monotonic() < until_s:
        yield True
