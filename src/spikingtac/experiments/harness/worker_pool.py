"""The worker processes of an experiment, none of which outlives it."""

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
def worker_pool(asked: int | None, pieces: int) -> Iterator[Executor]:
    """Lend worker processes; at the end, what was not begun is dropped.

    For a single worker that is a thread of this process.

    Args:
        asked: Workers; None is one for every CPU, and there are never more.
        pieces: Pieces of work: more workers than that would be idle.
    """
    for name in SINGLE_THREAD:
        os.environ.setdefault(name, "1")
    pool = _pool(max(1, min(asked or cpu_count(), cpu_count(), pieces)))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _pool(workers: int) -> Executor:
    if workers == 1:
        return ThreadPoolExecutor(1)
    # Fresh interpreters: a fork would copy the locks of threads that it does not copy.
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, spawn, initializer=end_with_parent)


def end_with_parent() -> None:
    """Let this process end when its parent has ended, however that was ended.

    A parent that is killed closes nothing: its workers would go on with what was queued.
    """
    threading.Thread(target=_outlive_nobody, daemon=True).start()


def _outlive_nobody() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
