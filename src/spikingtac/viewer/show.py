"""Open a subject, serve its page, and say at the end what was seen."""

from __future__ import annotations

import json
import time
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import DeviceError
from spikingtac.viewer.process import Opener, SessionProcess
from spikingtac.viewer.record import Record
from spikingtac.viewer.security import Gate
from spikingtac.viewer.server import make_app, serve

OPENING_S = 120.0
"""Kernels that are compiled for the first time take up to half of it."""
WAIT_S = 0.02


@dataclass(frozen=True, kw_only=True)
class Showing:
    """How a page is served.

    Attributes:
        host: Address to bind to.
        port: Port, or 0 for any free one.
        browser: Open the user's browser.
        seconds: End after so long, or None for never.
        repeat: Begin again at the end.
        picture: File for the summary picture, or None.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    browser: bool = True
    seconds: float | None = None
    repeat: bool = False
    picture: Path | None = None


def show(
    opener: Opener, arguments: dict[str, Any], showing: Showing, say: Callable[[str], None]
) -> dict[str, Any]:
    """Serve a subject until interrupted or until the time is up; return the summary.

    Args:
        opener: Makes the subject, in the session's process.
        arguments: Its keyword arguments.
        showing: How.
        say: Takes the lines for the user.

    Raises:
        SpikingTacError: The subject cannot be opened, or the port is taken.
    """
    gate = Gate.for_host(showing.host)
    session = SessionProcess(opener, arguments, repeat=showing.repeat)
    try:
        hello = _first_greeting(session)
        record, reference_px = Record(), np.array(hello["reference_px"])
        until_s = time.monotonic() + (showing.seconds or float("inf"))

        def alive() -> bool:
            record.take(session.frame(record.number), reference_px)
            return session.alive and time.monotonic() < until_s

        def ready(port: int) -> None:
            for line in addresses(showing.host, port, gate.token):
                say(line)
            if showing.browser:
                webbrowser.open(_url("127.0.0.1", port, gate.token))

        serve(make_app(session, session.command, gate), showing.host, showing.port, ready, alive)
        _raise_failure(session)
        summary = record.summary()
        if showing.picture is not None and record.save_picture(showing.picture, hello):
            summary["picture"] = str(showing.picture)
        return summary
    finally:
        session.close()


def addresses(host: str, port: int, token: str) -> list[str]:
    """Return what a user needs to reach the page, here and from another machine."""
    query = f"/?token={token}" if token else "/"
    return [
        f"open {_url(host, port, token)} (Ctrl-C ends)",
        f"from another machine: ssh -N -L {port}:127.0.0.1:{port} THIS_MACHINE, "
        f"then http://127.0.0.1:{port}{query}",
    ]


def _url(host: str, port: int, token: str) -> str:
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}/" + (f"?token={token}" if token else "")


def _first_greeting(session: SessionProcess) -> dict[str, Any]:
    until_s = time.monotonic() + OPENING_S
    while time.monotonic() < until_s:
        greeting = session.greeting(0)
        if greeting is not None:
            return json.loads(greeting[1])
        _raise_failure(session)
        if not session.alive:
            break
        time.sleep(WAIT_S)
    raise DeviceError(
        "the session did not start; see `spikingtac doctor`, and try again with --debug"
    )


def _raise_failure(session: SessionProcess) -> None:
    failure = session.failure()
    if failure is not None:
        raise failure
