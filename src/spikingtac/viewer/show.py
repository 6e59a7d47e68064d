"""Serve the page of views that run in processes of their own; return what was shown at the end."""

import os
import socket
import time
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from spikingtac.errors import DeviceError
from spikingtac.viewer.access import Gate, PageOptions, listen
from spikingtac.viewer.process import SHUTDOWN_S, SessionProcess
from spikingtac.viewer.server import PageServer, serve
from spikingtac.viewer.source import ViewSource

Report = Callable[[str], None]  # Takes a line for the user.
STILL_STARTING_S = 15.0  # How often the user reads that the first start goes on, s.
WAIT_S = 0.02  # Time between two looks for a view that is being opened, s.

# Nice value of the server: a third of an ordinary program's share on a busy machine.
NICENESS = 5


def show(
    open_views: Sequence[Callable[[], ViewSource]],
    options: PageOptions,
    report: Report,
    **played: Any,
) -> dict[str, Any]:
    """Serve one view, or two side by side, until interrupted or until the time is up.

    Args:
        open_views: Open the views, each in a session's process.
        options: How the page is served.
        report: Takes the lines for the user.
        **played: Options of :func:`spikingtac.viewer.process.run_session`.

    Returns:
        The summary of the first view; that of another one is its ``second``.

    Raises:
        SpikingTacError: A view cannot be opened, a file cannot be written, the port is taken, or a
            session was killed.
    """
    listening = listen(options.host, options.port)
    sessions = [SessionProcess(view, **played) for view in open_views]
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
    return first | ({"second": others[0]} if others else {})


def _serve(
    sessions: Sequence[SessionProcess],
    options: PageOptions,
    report: Report,
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
        if not options.no_browser:
            webbrowser.open(here)

    serve(PageServer(sessions, gate), listening, lambda: next(life, False), ready)
    for session in sessions:
        session.require_alive()


def _life(sessions: Sequence[SessionProcess], seconds: float, report: Report) -> Iterator[bool]:
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
    while all(session.alive() for session in sessions) and time.monotonic() < until_s:
        yield True
