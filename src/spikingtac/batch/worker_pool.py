"""The worker processes of an experiment; none of them outlives it."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait

SINGLE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that keep a library from starting threads of its own in every worker."""


def cpu_count() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def worker_pool(workers: int | None, tasks: int) -> Iterator[Executor]:
    """Start worker processes; at the end, tasks that were not begun are dropped.

    A single worker is a thread of this process.

    Args:
        workers: Number of workers; None takes one for every CPU, and there are never more.
        tasks: Number of tasks: more workers would be idle.

    Yields:
        The pool to submit the tasks to.
    """
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    pool = _pool(max(1, min(workers or cpu_count(), cpu_count(), tasks)))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _pool(workers: int) -> Executor:
    if workers == 1:
        return ThreadPoolExecutor(1)
    # Fresh interpreters: a fork would copy locks whose threads it does not copy.
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, spawn, initializer=end_with_parent)


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
