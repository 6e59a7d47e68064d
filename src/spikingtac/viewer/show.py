"""Open views, serve their page, and return what was shown at the end."""

from __future__ import annotations

import os
import socket
import time
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.errors import DeviceError
from spikingtac.stream.host import Factory
from spikingtac.viewer.access import Gate, listen
from spikingtac.viewer.process import SHUTDOWN_S, SessionProcess

if TYPE_CHECKING:
    from spikingtac.viewer.source import ViewSource

STILL_STARTING_S = 15.0  # How often the user reads that the first start goes on, s.
WAIT_S = 0.02  # Time between two looks for a view that is being opened, s.

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


def show(
    open_views: Sequence[Factory[ViewSource]], options: PageOptions, report: Callable[[str], None]
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
    names = ("repeat", "realtime", "picture")
    given = {name: getattr(options, name) for name in names}
    sessions = [SessionProcess(view, **given) for view in open_views]
    try:
        _serve(sessions, options, report, listening)
        told = [session.stop() for session in sessions]
    finally:
        listening.close()
        for session in sessions:
            session.close()
    summaries = [summary for summary in told if summary is not None]
    if len(summaries) < len(told):
        raise DeviceError(
            f"the session did not end within {SHUTDOWN_S:g} s and was killed; nothing is known of "
            "what it showed"
        )
    first, *others = summaries
    written = {} if options.picture is None else {"picture": str(options.picture)}
    return first | written | ({"second": others[0]} if others else {})


def _serve(
    sessions: Sequence[SessionProcess],
    options: PageOptions,
    report: Callable[[str], None],
    listening: socket.socket,
) -> None:
    from spikingtac.viewer.server import PageServer, serve  # beside the sessions

    gate = Gate.for_host(options.host)
    monitor = Monitor(sessions, options.seconds or float("inf"), report)
    while not all(session.greeting(0) for session in sessions):  # no page without a view
        monitor.expect_life()
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

    serve(PageServer(sessions, gate), listening, monitor.poll, ready)
    for session in sessions:
        session.require_alive()


class Monitor:
    """Follows the sessions beside the server, and decides when to end.

    Args:
        sessions: The sessions.
        seconds: Viewing time, s; compiling does not count.
        report: Takes the lines for the user.
    """

    def __init__(
        self, sessions: Sequence[SessionProcess], seconds: float, report: Callable[[str], None]
    ) -> None:
        self._sessions, self._seconds, self._report = sessions, seconds, report
        self._shown = False
        self._begun_s = self._reported_s = time.monotonic()
        self._until_s = float("inf")

    def poll(self) -> bool:
        """Return False once a session or the time has ended."""
        if self._shown:
            alive = all(session.alive for session in self._sessions)
            return alive and time.monotonic() < self._until_s
        self.expect_life()
        self._shown = all(session.frame(0) for session in self._sessions)
        if self._shown:
            self._until_s = time.monotonic() + self._seconds
        return True

    def expect_life(self) -> None:
        """Tell the user that the first start goes on.

        Raises:
            Exception: What ended a session.
        """
        now_s = time.monotonic()
        for session in self._sessions:
            session.require_alive()
        if now_s - self._reported_s > STILL_STARTING_S:
            self._reported_s = now_s
            self._report(
                "getting ready: the first start compiles kernels, and a camera has to send "
                f"its first events ({now_s - self._begun_s:.0f} s so far)"
            )
