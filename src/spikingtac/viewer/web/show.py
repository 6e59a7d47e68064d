"""Open views, serve their page, and return what was shown at the end."""

from __future__ import annotations

import json
import os
import socket
import time
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.errors import DeviceError
from spikingtac.stream.host import Factory
from spikingtac.viewer.web.access import Gate, addresses, listen, page_url
from spikingtac.viewer.web.process import SHUTDOWN_S, SessionProcess

if TYPE_CHECKING:
    from spikingtac.viewer.source import ViewSource

# Longest wait for the view, s. Compiling all kernels takes a minute of two idle cores, and some
# minutes of a slow or busy machine (ours: it was not done after 120 s beside four other
# programs).
OPENING_S = 1_800.0
STILL_STARTING_S = 15.0  # How often the user reads that the first start goes on, s.
WAIT_S = 0.02

# Nice value of the server: a third of an ordinary program's share on a busy machine (ours).
NICENESS = 5

# Commands that go to both of two sessions, whatever their clocks.
SHARED = frozenset({"play", "speed"})
SEEK = "seek_us"


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """How a page is served.

    Attributes:
        host: Address to bind to.
        port: Port, or 0 for any free one.
        browser: Open the user's browser.
        seconds: End after so long, or None for never.
        repeat: Begin again at the end.
        picture: File for the summary picture, or None.
        tracks: File for every estimate, or None.
        realtime: Whether the session asks for what helps to keep deadlines.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    browser: bool = True
    seconds: float | None = None
    repeat: bool = False
    picture: Path | None = None
    tracks: Path | None = None
    realtime: bool = False


def show(
    open_views: Sequence[Factory[ViewSource]],
    options: PageOptions,
    report: Callable[[str], None],
    *,
    one_clock: bool = False,
) -> dict[str, Any]:
    """Serve one view, or two side by side, until interrupted or until the time is up.

    Args:
        open_views: Open the views, each in a session's process.
        options: How the page is served; picture and tracks are those of a single view.
        report: Takes the lines for the user.
        one_clock: Whether two views' times are on one clock, so that both go to the same time.

    Returns:
        The summary of the first view; that of another one is its ``second``.

    Raises:
        SpikingTacError: A view cannot be opened, a file cannot be written, the port is taken, or a
            session was killed.
    """
    listening = listen(options.host, options.port)
    files = {"tracks": options.tracks, "picture": options.picture, "realtime": options.realtime}
    sessions = [SessionProcess(view, repeat=options.repeat, **files) for view in open_views]
    try:
        _serve(sessions, options, report, listening, one_clock)
        told = [session.stop() for session in sessions]
    finally:
        listening.close()
        for session in sessions:
            session.close()
    first, *others = (_complete(summary) for summary in told)
    names = ("tracks", "picture")
    written = {name: str(files[name]) for name in names if files[name] is not None}
    return first | written | ({"second": others[0]} if others else {})


def _complete(summary: dict[str, Any] | None) -> dict[str, Any]:
    if summary is None:
        raise DeviceError(
            f"the session did not end within {SHUTDOWN_S:g} s and was killed; its tracks are not "
            "complete"
        )
    return summary


def _serve(
    sessions: Sequence[SessionProcess],
    options: PageOptions,
    report: Callable[[str], None],
    listening: socket.socket,
    one_clock: bool,
) -> None:
    from spikingtac.viewer.web.server import make_app, serve  # beside the sessions

    gate = Gate.for_host(options.host)
    monitors = [Monitor(session, options.seconds, report) for session in sessions]

    for monitor in monitors:
        monitor.await_view()
    if hasattr(os, "nice"):  # a busy machine runs the sessions first, which have started
        os.nice(NICENESS)
    together = Together(sessions, one_clock=one_clock and len(sessions) > 1)

    def alive() -> bool:
        together.begin()
        return all([monitor.poll() for monitor in monitors])

    def ready() -> None:
        port = listening.getsockname()[1]
        for line in addresses(options.host, port, gate.token):
            report(line)
        if options.browser:
            webbrowser.open(page_url("127.0.0.1", port, gate.token))

    serve(make_app(sessions, together.commands, gate), listening, alive, ready)
    for session in sessions:
        session.require_alive()


class Monitor:
    """Follows a session beside the server, and decides when to end."""

    def __init__(
        self, session: SessionProcess, seconds: float | None, report: Callable[[str], None]
    ) -> None:
        self._report, self._session = report, session
        self._seconds, self._shown = seconds or float("inf"), False
        self._begun_s = self._reported_s = time.monotonic()
        self._until_s = self._begun_s + OPENING_S

    def await_view(self) -> None:
        """Wait until the view is open, so that no page is served without one."""
        while self._session.greeting(0) is None:
            self._expect_life()
            time.sleep(WAIT_S)

    def poll(self) -> bool:
        """Return False once the session or its time has ended."""
        if not self._shown:
            self._expect_life()
            self._shown = self._session.frame(0) is not None
            if self._shown:  # the given time is viewing time; compiling does not count
                self._until_s = time.monotonic() + self._seconds
            return True
        return self._session.alive and time.monotonic() < self._until_s

    def _expect_life(self) -> None:
        now_s = time.monotonic()
        self._session.require_alive()
        if now_s >= self._until_s:
            raise DeviceError(
                "the session did not start; see `spikingtac doctor`, and try again with --debug"
            )
        if now_s - self._reported_s > STILL_STARTING_S:
            self._reported_s = now_s
            self._report(
                "getting ready: the first start compiles kernels, and a camera has to send "
                f"its first events ({now_s - self._begun_s:.0f} s so far)"
            )


class Together:
    """Passes the commands of sessions' pages on; those of playback go to all of them.

    Args:
        sessions: The sessions.
        one_clock: Whether their times are on one clock: only then a time means the same to all.

    Attributes:
        commands: For each session, what takes the commands of its pages.
    """

    def __init__(self, sessions: Sequence[SessionProcess], *, one_clock: bool) -> None:
        self._sessions, self._one_clock = sessions, one_clock
        self._begun = not one_clock
        self.commands: list[Callable[[str, Any], None]] = [
            partial(self._pass_on, number) for number in range(len(sessions))
        ]

    def begin(self) -> None:
        """Bring all to the same time once they are ready; further calls do nothing."""
        if not self._begun and (spans := self._spans_us()) is not None:
            self._begun = True
            self._pass_on(0, SEEK, max(first for first, _ in spans))

    def _pass_on(self, number: int, name: str, value: Any) -> None:
        every = name in SHARED or (name == SEEK and self._one_clock)
        if name == SEEK and every and (spans := self._spans_us()) is not None:
            # The nearest time that all recordings hold, so that all go to the same one.
            last_us, first_us = min(last for _, last in spans), max(first for first, _ in spans)
            value = max(min(value, last_us), first_us)
        for session in self._sessions if every else self._sessions[number : number + 1]:
            session.command(name, value)

    def _spans_us(self) -> list[tuple[int, int]] | None:
        """Return beginning and end of each recording, or None while one of them gets ready."""
        spans = []
        for session in self._sessions:
            greeting = session.greeting(0)
            overview = json.loads(greeting[1]).get("overview") if greeting else None
            if overview is None:
                return None
            spans.append((int(overview["t_start_us"]), int(overview["t_end_us"])))
        return spans
