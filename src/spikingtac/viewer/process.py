"""The session's own process: a slow page, server or terminal never delays it.

A busy thread beside the tracking loop would stretch a step of half a millisecond to several, since
threads share one interpreter lock. The loop therefore runs in another process than the server.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.stream.host import Asker, Factory, Host, closed_by
from spikingtac.stream.ring import SharedRing
from spikingtac.viewer.wire import FRAME_BYTES, GREETING_BYTES, STOP

if TYPE_CHECKING:
    from spikingtac.viewer.source import ViewSource

# Longest wait for the session to complete its tracks, s; an idle machine needs 0.1 s.
SHUTDOWN_S = 20.0
LOOK_S = 0.1  # Longest wait for a word of the session, s.


class SessionProcess:
    """Starts a session in a process of its own and reads its latest frames.

    Args:
        open_view: Opens what is viewed, in the session's process.
        repeat: Begin again at the end.
        picture: File for a picture of what was shown, whole once :meth:`stop` has returned.
        realtime: Ask for what helps to keep deadlines, once the kernels are compiled.
    """

    def __init__(
        self,
        open_view: Factory[ViewSource],
        *,
        repeat: bool = False,
        picture: Path | None = None,
        realtime: bool = False,
    ) -> None:
        self._frames = SharedRing.for_latest(FRAME_BYTES)
        self._greetings = SharedRing.for_latest(GREETING_BYTES)
        options = {"repeat": repeat, "picture": picture, "realtime": realtime}
        rings = self._frames.name, self._greetings.name
        given = {"open_view": open_view, "options": options, "rings": rings}
        self._host = Host(Factory(function=_run, arguments=given), inherit=True)

    def frame(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest frame message with its number, or None if there is none newer."""
        return self._frames.latest(after)

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest greeting with its number, or None if there is none newer."""
        return self._greetings.latest(after)

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
            self._host.close()
            self._frames.close()
            self._greetings.close()


def _run(asker: Asker, **arguments: Any) -> None:
    # Imported only there: it needs every tracker, and the page's own process none of them.
    from spikingtac.viewer.hosted import run_session

    run_session(asker, **arguments)
