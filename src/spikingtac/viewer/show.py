"""Serve the page of a view that runs in a process of its own; return what was shown at the end."""

import os
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import closing
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
    open_view: Callable[[], ViewSource],
    options: PageOptions,
    report: Report,
    **played: Any,
) -> dict[str, Any]:
    """Serve a view until interrupted or until the time is up.

    Args:
        open_view: Opens the view, in the session's process.
        options: How the page is served.
        report: Takes the lines for the user.
        **played: Options of :func:`spikingtac.viewer.process.run_session`.

    Returns:
        The summary of the view.

    Raises:
        SpikingTacError: The view cannot be opened, a file cannot be written, the port is taken, or
            the session was killed.
    """
    gate = Gate.for_host(options.host)

    def ready() -> None:
        port, query = listening.getsockname()[1], f"?token={gate.token}" if gate.token else ""
        host = f"[{options.host}]" if ":" in options.host else options.host
        here = f"http://127.0.0.1:{port}/{query}"
        report(f"open http://{host}:{port}/{query} (Ctrl-C ends)")
        report(f"from another machine: ssh -N -L {port}:127.0.0.1:{port} THIS_MACHINE, then {here}")
        if not options.no_browser:
            webbrowser.open(here)

    with (
        listen(options.host, options.port) as listening,
        closing(SessionProcess(open_view, **played)) as session,
    ):
        life = _life(session, options.seconds or float("inf"), report)
        while not session.greetings.weight:  # no page without a view
            next(life)
            time.sleep(WAIT_S)
        if hasattr(os, "nice"):  # a busy machine runs the session first, which has started
            os.nice(NICENESS)
        serve(PageServer(session, gate), listening, lambda: next(life, False), ready)
        session.receive()  # raises what ended it
        summary = session.stop()
    if summary is None:
        raise DeviceError(
            f"the session did not end within {SHUTDOWN_S:g} s and was killed; nothing is known of "
            "what it showed"
        )
    return summary


def _life(session: SessionProcess, seconds: float, report: Report) -> Iterator[bool]:
    """Yield True while the session and the viewing time last, in which compiling does not count.

    Raises:
        Exception: What ended the session before its first frame.
    """
    begun_s = told_s = time.monotonic()
    while not session.frames.weight:
        session.receive()  # raises what has ended it
        if time.monotonic() - told_s > STILL_STARTING_S:
            told_s = time.monotonic()
            report(
                "getting ready: the first start compiles kernels, and a camera has to send "
                f"its first events ({told_s - begun_s:.0f} s so far)"
            )
        yield True
    until_s = time.monotonic() + seconds
    while session.alive() and time.monotonic() < until_s:
        yield True
