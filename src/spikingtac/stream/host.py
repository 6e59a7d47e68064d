"""Processes: a function of a module runs in an interpreter of its own, and ends with its asker.

The other interpreter imports what it needs by name and never the asker's main script, so that a
plain script without a guard around its main part may start one.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from typing import Any

from spikingtac.errors import DeviceError, SpikingTacError
from spikingtac.stream.real_time import ordinary_priority
from spikingtac.stream.ring import SharedRing

END_S = 1.0  # Longest wait for how a process has ended, s.
TERMINATE_S = 2.0  # Wait between the request to end and the kill of a process that hangs, s.

# Longest time that a process may take to complete its files once its asker is gone, s.
LONGEST_GRACE_S = 30.0


class Host:
    """Runs ``work`` in a process of its own; it ends when this object is closed or this process is.

    Args:
        what: Whose process it is, for its errors.
        work: A function of a module with its arguments, as ``functools.partial`` holds them; it is
            called there with an :class:`Asker`.
        *room_bytes: Room of each ring through which the work shows what it makes.

    Attributes:
        pid: The process's id.
        lost: Whether it was found to have ended before its work was done.
        rings: Those rings.
        patience_s: Longest wait for the process to end once it is asked to, s.
    """

    patience_s = TERMINATE_S

    def __init__(self, what: str, work: Callable[[Asker], object], *room_bytes: int) -> None:
        self._what, self._done, self.lost = what, False, False
        self.rings = [SharedRing.create(room) for room in room_bytes]
        self._channel, theirs = multiprocessing.Pipe()
        number = theirs.fileno()
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self._process = subprocess.Popen(
            # Standard input is handed on: it may be a source.
            [sys.executable, "-P", "-m", "spikingtac.stream.host", str(number)],
            pass_fds=(number,),
            env={**os.environ, "PYTHONPATH": paths},
        )
        self.pid = self._process.pid
        theirs.close()
        try:
            self._channel.send((work, [ring.name for ring in self.rings]))
        except BrokenPipeError:
            pass  # it has ended already, which is told by the first question
        except BaseException:
            self.close()
            raise

    @ordinary_priority()
    def alive(self) -> bool:
        """Return whether the process runs."""
        return self._process.poll() is None

    def tell(self, item: Any) -> bool:
        """Tell the work something, without waiting; False where it takes nothing now."""
        try:
            if not select.select([], [self._channel], [], 0.0)[1]:
                return False
            self._channel.send(item)
        except (OSError, ValueError):  # it has ended
            return False
        return True

    def receive(self, timeout_s: float = 0.0) -> Any:
        """Return the next thing that the work told, or None where it told nothing in time.

        Raises:
            EOFError: The work is done, and everything that it told was returned.
            DeviceError: The process has ended before that, and is :attr:`lost`.
            Exception: What the work raised, once.
        """
        try:
            # Connection.poll would make a selector each time, 30 us.
            ready = select.select([self._channel], [], [], timeout_s)[0]
            item = self._channel.recv() if ready else None
        except (EOFError, OSError) as error:
            if self._done:
                raise EOFError from error
            self.wait(END_S)
            killed = self._process.poll() == -signal.SIGKILL
            how = "was killed; the machine may have run out of memory" if killed else "ended"
            self.lost = True
            raise DeviceError(f"the process of {self._what} {how}; start it again") from error
        if isinstance(item, Exception):  # the last word: EOFError where the work is done
            self._done = isinstance(item, EOFError)
            raise item
        return item

    @ordinary_priority()
    def wait(self, seconds: float) -> bool:
        """Wait until the process has ended, but not longer; True where it has."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self._process.poll() is not None

    @ordinary_priority()
    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.wait()

    @ordinary_priority()
    def close(self) -> None:
        """Ask the process to end, kill it where it does not, and release rings and channel.

        Harmless when repeated.
        """
        if self._process.poll() is None:
            self._process.terminate()
            if not self.wait(self.patience_s):
                self.kill()
        self._channel.close()
        for ring in self.rings:
            ring.close()


class Asker:
    """The process that asked for this one's work, as the work sees it.

    Once it is gone, ``gone`` is set, and this process ends by force after :attr:`grace_s`.

    Attributes:
        gone: Set when the asker has ended or closed its side.
        grace_s: Time for the work to end by itself then, s; work that completes files sets it.
        rings: Those of its :class:`Host`, to write into.
    """

    def __init__(self, channel: Connection, rings: Iterable[str]) -> None:
        self.rings = [SharedRing.attach(name) for name in rings]
        self.gone = threading.Event()
        self.grace_s = 0.0
        self._channel, self._lock = channel, threading.Lock()
        self._said: deque[Any] = deque()
        # It waits in a read, and costs the work nothing.
        threading.Thread(target=self._listen, daemon=True).start()

    def said(self) -> list[Any]:
        """Return what the asker has told since the last call."""
        return [self._said.popleft() for _ in range(len(self._said))]

    def tell(self, item: Any) -> None:
        """Tell the asker something; waits while it takes nothing.

        Raises:
            SystemExit: It is gone.
        """
        try:
            with self._lock:
                self._channel.send(item)
        except OSError as error:
            raise SystemExit(1) from error

    def _listen(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                self._said.append(self._channel.recv())
        self.gone.set()
        time.sleep(min(self.grace_s, LONGEST_GRACE_S))
        os._exit(1)


def end_in_order() -> None:
    """Let a request to end this process unwind its work, which gives back what it holds."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def serve(number: int) -> None:
    """Do the work that arrives at an inherited channel; the whole life of a hosted process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the asker's matter
    channel: Connection = Connection(number)
    try:
        work, rings = channel.recv()
        asker = Asker(channel, rings)
    except EOFError:
        return
    except Exception as error:  # its module cannot be imported here, or its asker is gone
        with contextlib.suppress(OSError):
            channel.send(_sendable(error))
        raise SystemExit(1) from error
    told: Exception = EOFError()
    try:
        work(asker)
    except Exception as error:  # raised by the asker
        told = _sendable(error)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends now: to interrupt that would be told
    asker.tell(told)


def _sendable(error: Exception) -> Exception:
    """Return an error as it can be sent to another process."""
    known = isinstance(error, SpikingTacError | OSError)
    return error if known else RuntimeError(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    from spikingtac.stream import host  # the module by its name: what arrives refers to that one

    host.serve(int(sys.argv[1]))
