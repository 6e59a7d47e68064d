"""Worker processes of this machine, each with a task of its own."""

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

from spikingtac.errors import DeviceError

# Variables that keep a library from starting threads of its own in every worker.
SINGLE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# Deaths of a worker after which its task counts as failed: one may be the machine's fault.
ATTEMPTS = 2


@contextmanager
def worker_pool(workers: int | None, tasks: int, isolated: bool = False) -> Iterator[Executor]:
    """Start workers; at the end, tasks that have not ended are dropped and processes are killed.

    Args:
        workers: Number of processes; None takes one for every CPU, and there are never more.
        tasks: Number of tasks: more workers would be idle.
        isolated: Whether a single worker is a process, too, not a thread of this one.

    Yields:
        The pool to submit the tasks to. A task whose worker dies is tried once more.
    """
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    affinity = getattr(os, "sched_getaffinity", None)
    cpus = len(affinity(0)) if affinity else os.cpu_count() or 1
    count = max(1, min(workers or cpus, cpus, tasks))
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
        self._threads = ThreadPoolExecutor(count)
        self._own = threading.local()  # the pool of each thread
        self._pools: list[ProcessPoolExecutor] = []  # all that were started
        self._processes: dict[ProcessPoolExecutor, int] = {}  # pool -> id of its living process
        self._ended = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a task in the next idle process."""
        return self._threads.submit(self._run, partial(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: those at work are killed where ``cancel_futures`` is set."""
        self._threads.shutdown(wait=not cancel_futures and wait, cancel_futures=cancel_futures)
        self._ended = True
        for pool in list(self._processes):
            self._kill(pool)
        self._threads.shutdown(wait=wait)
        for pool in self._pools:
            pool.shutdown()  # joins its thread: at the interpreter's end its pipe may be gone

    def _run(self, task: Callable[[], Any]) -> Any:
        for _ in range(ATTEMPTS):
            try:
                return self._pool().submit(task).result()
            except BrokenProcessPool:
                self._processes.pop(self._own.__dict__.pop("pool", None), None)
        raise DeviceError(
            f"the worker process was killed {ATTEMPTS} times while it had this recording (the "
            "system's log tells by whom); try it alone, or with fewer workers"
        )

    def _pool(self) -> ProcessPoolExecutor:
        """Return the pool of this thread, started again after the death of its process."""
        if self._ended:
            raise BrokenProcessPool
        if not hasattr(self._own, "pool"):
            # Fresh interpreters: a fork would copy locks whose threads it does not copy.
            pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_begin)
            self._pools.append(pool)
            self._processes[pool] = pool.submit(os.getpid).result()
            self._own.pool = pool
            if self._ended:
                self._kill(pool)
        return self._own.pool

    def _kill(self, pool: ProcessPoolExecutor) -> None:
        with suppress(KeyError, ProcessLookupError):  # it may have died by itself
            os.kill(self._processes[pool], getattr(signal, "SIGKILL", signal.SIGTERM))


def _begin() -> None:
    """Leave Ctrl-C to the parent, which decides what ends, and end with it.

    A parent that is killed closes nothing: its workers would continue with the queued tasks.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
