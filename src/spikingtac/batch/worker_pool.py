"""Where tasks run: worker processes of this machine, or a Dask cluster in their place."""

from __future__ import annotations

import ipaddress
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait
from typing import Any
from urllib.parse import urlsplit

from spikingtac._version import package_version
from spikingtac.errors import ConfigError, DeviceError, MissingExtraError

# Variables that keep a library from starting threads of its own in every worker.
SINGLE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# Deaths of a worker after which its task counts as failed: one may be the machine's fault.
ATTEMPTS = 2
CONNECT_S = 10.0  # Longest wait for a Dask scheduler, s.


def cpu_count() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def worker_pool(
    workers: int | None, tasks: int, scheduler: str | None = None, isolated: bool = False
) -> Iterator[Executor]:
    """Start workers; at the end, tasks that have not ended are dropped and processes are killed.

    Args:
        workers: Number of processes; None takes one for every CPU, and there are never more.
        tasks: Number of tasks: more workers would be idle.
        scheduler: Address of a Dask scheduler that takes the place of the processes.
        isolated: Whether a single worker is a process, too, not a thread of this one.

    Yields:
        The pool to submit the tasks to. A task whose worker dies is tried once more.

    Raises:
        ConfigError: The address of the scheduler is not to be connected to.
        DeviceError: No scheduler answers, or it has no worker.
    """
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield executor
        return
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    count = max(1, min(workers or cpu_count(), cpu_count(), tasks))
    pool = ThreadPoolExecutor(1) if count == 1 and not isolated else WorkerProcesses(count)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class WorkerProcesses(Executor):
    """Process pools of one worker each, so that the death of a worker tells which task it had.

    A ``ProcessPoolExecutor`` of several workers breaks as a whole when one of them is killed.

    Args:
        count: Number of processes; they are started as they are needed.
    """

    def __init__(self, count: int) -> None:
        self._workers: list[_Worker] = []
        self._own = threading.local()
        self._threads = ThreadPoolExecutor(count, initializer=self._hire)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a task in the next idle process."""
        return self._threads.submit(lambda: self._own.worker.run(partial(fn, *args, **kwargs)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: those at work are killed where ``cancel_futures`` is set."""
        self._threads.shutdown(wait=not cancel_futures and wait, cancel_futures=cancel_futures)
        for worker in self._workers:
            worker.kill()
        self._threads.shutdown(wait=wait)
        for worker in self._workers:
            worker.close()

    def _hire(self) -> None:
        """Give a thread a process of its own."""
        self._own.worker = _Worker()
        self._workers.append(self._own.worker)


class _Worker:
    """One process, which is started again after its death."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._pid: int | None = None
        self._ended = False

    def run(self, task: Callable[[], Any]) -> Any:
        for _ in range(ATTEMPTS):
            try:
                pool = self._pool or self._start()
                if not self._ended:
                    return pool.submit(task).result()
            except BrokenProcessPool:
                self._pool = self._pid = None
        raise DeviceError(
            f"the worker process was killed {ATTEMPTS} times while it had this recording (the "
            "system's log tells by whom); try it alone, or with fewer workers"
        )

    def kill(self) -> None:
        self._ended = True
        if self._pid is not None:
            with suppress(ProcessLookupError):
                os.kill(self._pid, getattr(signal, "SIGKILL", signal.SIGTERM))

    def close(self) -> None:
        """Join the pool's own thread: at the interpreter's end its pipe may be gone."""
        if self._pool is not None:
            self._pool.shutdown()

    def _start(self) -> ProcessPoolExecutor:
        # Fresh interpreters: a fork would copy locks whose threads it does not copy.
        spawn = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(1, spawn, initializer=_begin)
        self._pid, self._pool = pool.submit(os.getpid).result(), pool
        if self._ended:
            self.kill()
        return pool


def _begin() -> None:
    """Leave Ctrl-C to the parent, which decides what ends, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()


def end_with_parent() -> None:
    """End this process when its parent has ended, in whatever way.

    A parent that is killed closes nothing: its workers would continue with the queued tasks.
    """
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler; TLS certificates come from Dask's own configuration."""
    check_scheduler(address)
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtraError(
            "a Dask cluster needs distributed; install it with: pip install 'spikingtac[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, TypeError, ValueError) as error:
        raise DeviceError(
            f"no Dask scheduler answers at {address}: {error}; start one with: "
            "dask scheduler --host 127.0.0.1"
        ) from error
    with client:
        told: Any = client.run(package_version)
        versions: set[str] = set(told.values())
        if not versions:
            raise DeviceError(f"the cluster has no worker; start one: dask worker {address}")
        if versions != {package_version()}:
            raise ConfigError(
                f"workers of the cluster run spikingtac {', '.join(sorted(versions))}, this is "
                f"{package_version()}; install the same version on every machine"
            )
        yield client.get_executor(pure=False)


def check_scheduler(address: str) -> None:
    """Refuse a Dask scheduler that is reached over the network without encryption.

    Whoever reaches a scheduler can run code on its workers, and Dask has no password.

    Raises:
        ConfigError: The address is none, or is neither of this machine nor encrypted.
    """
    parts = urlsplit(address)
    if parts.scheme not in ("tcp", "tls") or not parts.hostname:
        raise ConfigError(
            f"--scheduler {address!r} is no address; valid are tcp://127.0.0.1:8786 and "
            "tls://HOST:8786"
        )
    if parts.scheme == "tcp" and not _is_loopback(parts.hostname):
        raise ConfigError(
            f"--scheduler {address!r} would send work over the network without encryption or "
            "password; use tls://, or a tunnel: ssh -L 8786:127.0.0.1:8786 HOST"
        )


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
