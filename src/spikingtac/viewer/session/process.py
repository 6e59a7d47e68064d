"""The session's own process: a slow page, server or terminal never delays it.

A busy thread beside the tracking loop would stretch a step of half a millisecond to several, since
threads share one interpreter lock. The loop therefore runs in another process than the server.
"""

from __future__ import annotations

import multiprocessing
import queue
import threading
from multiprocessing.util import Finalize
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.live.factory import Factory
from spikingtac.live.process_source import INHERITING
from spikingtac.live.ring import SharedRing
from spikingtac.viewer.session.wire import FRAME_BYTES, GREETING_BYTES

if TYPE_CHECKING:
    from spikingtac.viewer.session.source import ViewSource

MOST_COMMANDS = 64
"""Commands that may wait for the loop; a page that sends faster loses the surplus."""
TERMINATE_S = 2.0
"""Wait between the request to end and the kill of a process that hangs (ours)."""
SHUTDOWN_S = 20.0
"""Longest wait for the session to complete its tracks; an idle machine needs 0.1 s."""


class SessionProcess:
    """Starts a session in a process of its own and reads its latest frames.

    Attributes:
        dropped_commands: Commands that found the queue full.
    """

    def __init__(
        self,
        open_view: Factory[ViewSource],
        *,
        repeat: bool = False,
        tracks: Path | None = None,
        realtime: bool = False,
    ) -> None:
        """Start.

        Args:
            open_view: Opens what is viewed, in the session's process.
            repeat: Begin again at the end.
            tracks: File for every estimate, complete once :meth:`close` has returned True.
            realtime: Ask for what helps to keep deadlines, once the kernels are compiled.
        """
        # A fork inherits what is imported; beside other threads, whose locks it would keep, none.
        alone = threading.active_count() == 1
        context: Any = multiprocessing.get_context(INHERITING if alone else "spawn")
        self.dropped_commands = 0
        self._frames = SharedRing.create(FRAME_BYTES)
        self._greetings = SharedRing.create(GREETING_BYTES)
        self._commands = context.Queue(MOST_COMMANDS)
        self._failures = context.Queue(1)
        self._stopped = context.Event()
        names = self._frames.name, self._greetings.name
        channels = names, self._commands, self._failures, self._stopped
        options = {"repeat": repeat, "tracks": tracks, "realtime": realtime}
        self._process = context.Process(target=_run, args=(open_view, options, channels))
        self._process.start()
        # Not a daemon: a daemon may start no process for a simulated sensor. It is therefore asked
        # to end before the interpreter waits for it.
        Finalize(None, self._stopped.set, exitpriority=1)

    def frame(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest frame message with its number, or None if there is none newer."""
        return self._frames.latest(after)

    def greeting(self, after: int) -> tuple[int, bytes] | None:
        """Return the latest greeting with its number, or None if there is none newer."""
        return self._greetings.latest(after)

    def command(self, name: str, value: Any) -> None:
        """Pass a command on; never waits."""
        try:
            self._commands.put_nowait((name, value))
        except queue.Full:
            self.dropped_commands += 1

    def failure(self) -> Exception | None:
        """Return the error that ended the session, or None while it runs."""
        try:
            return self._failures.get_nowait()
        except queue.Empty:
            return None

    @property
    def alive(self) -> bool:
        """True while the process runs."""
        return self._process.is_alive()

    @property
    def killed(self) -> bool:
        """True once a signal has ended the process, from here or from elsewhere."""
        return (self._process.exitcode or 0) < 0

    @property
    def pid(self) -> int | None:
        """The process's id."""
        return self._process.pid

    def stop(self) -> None:
        """Stop the process; its last frame can be read until :meth:`close`."""
        self._stopped.set()
        self._process.join(SHUTDOWN_S)

    def close(self) -> bool:
        """Stop the process and release the shared memory; True where it ended without an error."""
        try:
            self.stop()
        finally:  # also where a second Ctrl-C cuts the wait short
            self._end_process()
            for channel in (self._commands, self._failures):
                channel.cancel_join_thread()
                channel.close()
            self._frames.close()
            self._greetings.close()
        return self._process.exitcode == 0

    def _end_process(self) -> None:
        """End a process that hangs: a stopped one does not answer to a polite request."""
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(TERMINATE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(*arguments: Any) -> None:
    # Imported only there: it needs every tracker, and the page's own process none of them.
    from spikingtac.viewer.session.own_process.loop import run_session

    run_session(*arguments)
