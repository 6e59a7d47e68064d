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
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from spikingtac.errors import DeviceError, SpikingTacError
from spikingtac.stream.real_time import ordinary_priority
from spikingtac.types import EventPacket, LossCounters

POLL_S = 0.05  # Longest wait for a simulation before it is asked whether it goes on, s.
END_S = 1.0  # Longest wait for how a process has ended, s.
TERMINATE_S = 2.0  # Wait between the request to end and the kill of a process that hangs, s.

# Longest time that a process may take to complete its files once its asker is gone, s.
LONGEST_GRACE_S = 30.0


class _Failure:
    """An error as it can be sent to another process."""

    def __init__(self, error: Exception) -> None:
        sendable = isinstance(error, SpikingTacError | OSError)
        self.error = error if sendable else RuntimeError(f"{type(error).__name__}: {error}")


class Host:
    """Runs ``work`` in a process of its own; it ends when this object is closed or this process is.

    Args:
        work: A function of a module with its arguments, as ``functools.partial`` holds them; it is
            called there with an :class:`Asker`.

    Attributes:
        pid: The process's id.
    """

    def __init__(self, work: Callable[[Asker], object]) -> None:
        self._channel, theirs = multiprocessing.Pipe()
        number = theirs.fileno()
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "spikingtac.stream.host", str(number)],
            stdin=None,  # a source may be standard input
            pass_fds=(number,),
            env={**os.environ, "PYTHONPATH": paths},
        )
        self.pid = self._process.pid
        theirs.close()
        try:
            self._channel.send(work)
        except BrokenPipeError:
            pass  # it has ended already, which is told by the first question
        except BaseException:
            self.close()
            raise

    @property
    def killed(self) -> bool:
        """True once a signal has ended the process, from here or from elsewhere."""
        return (self._process.poll() or 0) < 0

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
            EOFError: The process has ended, and everything that it told was returned.
            Exception: What the work raised, once.
        """
        try:
            # Connection.poll would make a selector each time, 30 us.
            ready = select.select([self._channel], [], [], timeout_s)[0]
            item = self._channel.recv() if ready else None
        except OSError as error:  # reset, or closed here
            raise EOFError from error
        if isinstance(item, _Failure):
            raise item.error
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
    def close(self, patience_s: float = TERMINATE_S) -> None:
        """Ask the process to end, kill it where it does not, and release the channel."""
        if self._process.poll() is None:
            self._process.terminate()
            if not self.wait(patience_s):
                self.kill()
        self._channel.close()


class Asker:
    """The process that asked for this one's work, as the work sees it.

    Once it is gone, ``gone`` is set, and this process ends by force after :attr:`grace_s`.

    Attributes:
        gone: Set when the asker has ended or closed its side.
        grace_s: Time for the work to end by itself then, s; work that completes files sets it.
    """

    def __init__(self, channel: Connection) -> None:
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


def closed_by(host: Host, what: str) -> DeviceError:
    """Return the error of a process that has ended without a word."""
    host.wait(END_S)
    how = "was killed; the machine may have run out of memory" if host.killed else "ended"
    return DeviceError(f"the process of {what} {how}; start it again")


class RemoteSource:
    """A simulation in a process of its own; it waits for its user, and loses nothing.

    It is an :class:`~spikingtac.events.source.EventSource`. A simulated sensor costs about as much
    as a tracker; side by side in one process they would share an interpreter lock, and neither
    would keep up.

    Args:
        opened: Opens it there: packets with side data.
        size: ``(width, height)`` of the packets, px.
        take_side_data: Called with each packet's side data before the packet is yielded.
    """

    def __init__(
        self,
        opened: Callable[[], Iterable[tuple[EventPacket, Any]]],
        size: tuple[int, int],
        take_side_data: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self.size, self.losses = size, LossCounters()
        self._take = take_side_data
        self._host = Host(partial(_simulate, opened=opened))

    def __iter__(self) -> Iterator[EventPacket]:
        while True:
            try:
                told = self._host.receive(POLL_S)
            except EOFError as error:
                raise closed_by(self._host, "the events") from error
            if told == ():
                return
            if told is not None:
                packet, side_data = told
                self._take(side_data)
                yield packet

    def close(self) -> None:
        """Stop the other process."""
        self._host.close()


def _simulate(asker: Asker, opened: Callable[[], Iterable[tuple[EventPacket, Any]]]) -> None:
    """Tell the asker each packet with its side data; it waits while the channel is full."""
    for told in opened():
        asker.tell(told)
    asker.tell(())


def serve(number: int) -> None:
    """Do the work that arrives at an inherited channel; the whole life of a hosted process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the asker's matter
    channel: Connection = Connection(number)
    try:
        work: Callable[[Asker], object] = channel.recv()
    except EOFError:
        return
    except Exception as error:  # its module cannot be imported here
        channel.send(_Failure(error))
        raise SystemExit(1) from error
    asker = Asker(channel)
    try:
        work(asker)
    except Exception as error:  # raised by the asker
        asker.tell(_Failure(error))
        raise SystemExit(1) from error


if __name__ == "__main__":
    from spikingtac.stream import host  # the module by its name: what arrives refers to that one

    host.serve(int(sys.argv[1]))
