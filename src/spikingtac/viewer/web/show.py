"""Open a subject, serve its page, and say at the end what was seen."""

from __future__ import annotations

import json
import os
import time
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import DeviceError
from spikingtac.viewer.export.output_files import check_picture, check_tracks
from spikingtac.viewer.export.summary import Record
from spikingtac.viewer.session.process import Opener, SessionProcess
from spikingtac.viewer.web.security import Gate
from spikingtac.viewer.web.server import make_app, serve

OPENING_S = 120.0
"""Kernels that are compiled for the first time take up to half of it."""
WAIT_S = 0.02
NICENESS = 5
"""Steps below ordinary programs: a third of their share where all are busy (ours)."""


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
        tracks: File for every estimate, or None.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    browser: bool = True
    seconds: float | None = None
    repeat: bool = False
    picture: Path | None = None
    tracks: Path | None = None


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
        SpikingTacError: The subject cannot be opened, a file cannot be written where it was asked
            for, or the port is taken.
    """
    if showing.picture is not None:
        check_picture(showing.picture)
    if showing.tracks is not None:
        check_tracks(showing.tracks)
    session = SessionProcess(opener, arguments, repeat=showing.repeat, tracks=showing.tracks)
    ended_well = False
    try:
        summary = _served(session, showing, say)
    finally:
        ended_well = session.close()
    if showing.tracks is not None and ended_well:
        summary["tracks"] = str(showing.tracks)
    return summary


def _served(
    session: SessionProcess, showing: Showing, say: Callable[[str], None]
) -> dict[str, Any]:
    gate, watch = Gate.for_host(showing.host), _Watch(session, showing.seconds)

    def ready(port: int) -> None:
        for line in addresses(showing.host, port, gate.token):
            say(line)
        if showing.browser:
            webbrowser.open(_url("127.0.0.1", port, gate.token))

    watch.await_subject()
    _give_way_to_tracking()
    app = make_app(session, session.command, gate)
    serve(app, showing.host, showing.port, ready, watch.look)
    _raise_failure(session)
    summary = watch.record.summary()
    if showing.picture is not None and watch.save_picture(showing.picture):
        summary["picture"] = str(showing.picture)
    return summary


class _Watch:
    """Follows a session from beside the server: keeps the record and says when to end."""

    def __init__(self, session: SessionProcess, seconds: float | None) -> None:
        self.record = Record()
        self._session, self._seconds = session, seconds or float("inf")
        self._hello: dict[str, Any] | None = None
        self._until_s = time.monotonic() + OPENING_S

    def await_subject(self) -> None:
        """Wait until the subject is open, so that a page is never shown for what is not there."""
        while self._session.greeting(0) is None:
            _raise_failure(self._session)
            self._expect_life()
            time.sleep(WAIT_S)

    def look(self) -> bool:
        """Take the latest frame; False once the session or its time has ended."""
        if self._hello is None and not self._greeted():
            self._expect_life()
            return True
        frame = self._session.frame(self.record.number)
        if frame is not None:
            # The time that was asked for is time to look, not to compile.
            if not self.record.number:
                self._until_s = time.monotonic() + self._seconds
            self.record.take(frame, self._reference_px)
        return self._session.alive and time.monotonic() < self._until_s

    def save_picture(self, path: Path) -> bool:
        """Write the summary picture; False where no frame was seen."""
        return self._hello is not None and self.record.save_picture(path, self._hello)

    def _greeted(self) -> bool:
        greeting = self._session.greeting(0)
        document = {"starting": ""} if greeting is None else json.loads(greeting[1])
        if "starting" in document:
            return False
        self._hello, self._reference_px = document, np.array(document["reference_px"])
        return True

    def _expect_life(self) -> None:
        if self._session.alive and time.monotonic() < self._until_s:
            return
        _raise_failure(self._session)
        raise DeviceError(
            "the session did not start; see `spikingtac doctor`, and try again with --debug"
        )


def addresses(host: str, port: int, token: str) -> list[str]:
    """Return what a user needs to reach the page, here and from another machine."""
    query = f"/?token={token}" if token else "/"
    return [
        f"open {_url(host, port, token)} (Ctrl-C ends)",
        f"from another machine: ssh -N -L {port}:127.0.0.1:{port} THIS_MACHINE, "
        f"then http://127.0.0.1:{port}{query}",
    ]


def _give_way_to_tracking() -> None:
    """Serve pages with what the session and a simulated sensor leave of a busy machine."""
    if hasattr(os, "nice"):  # the session's processes have started, and keep their own
        os.nice(NICENESS)


def _url(host: str, port: int, token: str) -> str:
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}/" + (f"?token={token}" if token else "")


def _raise_failure(session: SessionProcess) -> None:
    failure = session.failure()
    if failure is not None:
        raise failure
