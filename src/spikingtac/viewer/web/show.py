"""Open a view, serve its page, and summarize the session at the end."""

from __future__ import annotations

import json
import os
import time
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac.atomic_files import require_free
from spikingtac.errors import DeviceError
from spikingtac.stream.host import Factory
from spikingtac.viewer.export.output_files import check_picture
from spikingtac.viewer.export.summary import Record
from spikingtac.viewer.pair.together import Together
from spikingtac.viewer.session.process import SHUTDOWN_S, SessionProcess
from spikingtac.viewer.web.address import addresses, check_address, page_url
from spikingtac.viewer.web.security import Gate

if TYPE_CHECKING:
    from spikingtac.viewer.session.source import ViewSource

OPENING_S = 1_800.0
"""Longest wait for the view, s. Compiling all kernels takes a minute of two idle cores, and some
minutes of a slow or busy machine (ours: it was not done after 120 s beside four other programs)."""
STILL_STARTING_S = 15.0
"""How often the user reads that the first start goes on, s."""
WAIT_S = 0.02
NICENESS = 5
"""Nice value of the server: a third of an ordinary program's share on a busy machine (ours)."""


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
        overwrite: Whether these files may be replaced.
        realtime: Whether the session asks for what helps to keep deadlines.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    browser: bool = True
    seconds: float | None = None
    repeat: bool = False
    picture: Path | None = None
    tracks: Path | None = None
    overwrite: bool = False
    realtime: bool = False


def show_pair(
    open_views: Sequence[Factory[ViewSource]],
    options: PageOptions,
    report: Callable[[str], None],
    *,
    one_clock: bool,
) -> dict[str, Any]:
    """Serve two views on one page until interrupted or until the time is up.

    Args:
        open_views: Open the views, each in a session's process.
        options: How the page is served; pictures and tracks are those of a single view.
        report: Takes the lines for the user.
        one_clock: Whether their times are on one clock, so that both go to the same time.

    Returns:
        The summary of the first one; that of the other is its ``second``.

    Raises:
        SpikingTacError: As of :func:`show`.
    """
    check_address(options.host, options.port)
    sessions = [SessionProcess(view, repeat=options.repeat) for view in open_views]
    together = Together(sessions, one_clock=one_clock)
    try:
        monitors = _served(sessions, options, report, together)
        for session, monitor in zip(sessions, monitors, strict=True):
            session.stop()
            monitor.take_frame()
    finally:
        for session in sessions:
            session.close()
    first, second = (monitor.record.summary() for monitor in monitors)
    return {**first, "second": second}


def show(
    open_view: Factory[ViewSource], options: PageOptions, report: Callable[[str], None]
) -> dict[str, Any]:
    """Serve a view until interrupted or until the time is up; return the summary.

    Args:
        open_view: Opens the view, in the session's process.
        options: How the page is served.
        report: Takes the lines for the user.

    Raises:
        SpikingTacError: The view cannot be opened, a file cannot be written, the port is taken, or
            the session was killed.
    """
    check_address(options.host, options.port)
    if options.picture is not None:
        check_picture(options.picture, options.overwrite)
    if options.tracks is not None:
        require_free(options.tracks, options.overwrite)
    session = SessionProcess(
        open_view, repeat=options.repeat, tracks=options.tracks, realtime=options.realtime
    )
    ended_well = False
    try:
        (monitor,) = _served([session], options, report)
        session.stop()  # what is summarized ends where the tracks do
        monitor.take_frame()
    finally:
        ended_well = session.close()
    if session.killed:
        raise DeviceError(
            f"the session did not end within {SHUTDOWN_S:g} s and was killed; its tracks are not "
            "complete"
        )
    summary = monitor.record.summary()
    if options.picture is not None and monitor.save_picture(options.picture):
        summary["picture"] = str(options.picture)
    if options.tracks is not None and ended_well:
        summary["tracks"] = str(options.tracks)
    return summary


def _served(
    sessions: Sequence[SessionProcess],
    options: PageOptions,
    report: Callable[[str], None],
    together: Together | None = None,
) -> list[_SessionMonitor]:
    from spikingtac.viewer.web.server import make_app, make_pair_app, serve  # beside the sessions

    gate = Gate.for_host(options.host)
    monitors = [_SessionMonitor(session, options.seconds, report) for session in sessions]

    def ready(port: int) -> None:
        for line in addresses(options.host, port, gate.token):
            report(line)
        if options.browser:
            webbrowser.open(page_url("127.0.0.1", port, gate.token))

    for monitor in monitors:
        monitor.await_view()
    _lower_priority()
    if together is None:
        app = make_app(sessions[0], sessions[0].command, gate)
    else:
        app = make_pair_app(sessions, together.commands, gate)

    def alive() -> bool:
        if together is not None:
            together.begin()
        return all([monitor.poll() for monitor in monitors])

    serve(app, options.host, options.port, ready, alive)
    for session in sessions:
        session.require_alive()
    return monitors


class _SessionMonitor:
    """Follows a session beside the server: keeps its record and decides when to end."""

    def __init__(
        self, session: SessionProcess, seconds: float | None, report: Callable[[str], None]
    ) -> None:
        self._report = report
        self.record = Record()
        self._session, self._seconds = session, seconds or float("inf")
        self._hello: dict[str, Any] | None = None
        self._greeted = 0
        self._begun_s = self._reported_s = time.monotonic()
        self._until_s = self._begun_s + OPENING_S

    def await_view(self) -> None:
        """Wait until the view is open, so that no page is served without one."""
        while self._session.greeting(0) is None:
            self._session.require_alive()
            self._expect_life()
            time.sleep(WAIT_S)

    def poll(self) -> bool:
        """Take the latest frame; False once the session or its time has ended."""
        if not self._take_greeting():
            self._expect_life()
            return True
        if not self.record.number and self._session.frame(0) is not None:
            # The given time is viewing time; compiling does not count.
            self._until_s = time.monotonic() + self._seconds
        self.take_frame()
        return self._session.alive and time.monotonic() < self._until_s

    def take_frame(self) -> None:
        """Note the latest frame, if there is one that was not noted."""
        if self._take_greeting():
            self.record.take(self._session.frame(self.record.number), self._reference_px)

    def save_picture(self, path: Path) -> bool:
        """Write the summary picture; False where no frame was seen."""
        return self._hello is not None and self.record.save_picture(path, self._hello)

    def _take_greeting(self) -> bool:
        """Take the latest greeting, which may name other markers; True once there was one."""
        greeting = self._session.greeting(self._greeted)
        if greeting is not None:
            self._greeted, document = greeting[0], json.loads(greeting[1])
            if "starting" not in document:
                if self._hello and self._hello.get("opened") != document.get("opened"):
                    self.record = Record(after=self.record.number)  # of what is shown in the end
                self._hello = document
                self._reference_px = np.array(document["reference_px"]).reshape(-1, 2)
        return self._hello is not None

    def _expect_life(self) -> None:
        now_s = time.monotonic()
        if self._session.alive and now_s < self._until_s:
            if now_s - self._reported_s > STILL_STARTING_S:
                self._reported_s = now_s
                self._report(
                    "getting ready: the first start compiles kernels, and a camera has to send "
                    f"its first events ({now_s - self._begun_s:.0f} s so far)"
                )
            return
        self._session.require_alive()
        raise DeviceError(
            "the session did not start; see `spikingtac doctor`, and try again with --debug"
        )


def _lower_priority() -> None:
    """Let the session and a simulated sensor go first on a busy machine."""
    if hasattr(os, "nice"):  # the session's processes have started, and keep their own
        os.nice(NICENESS)
