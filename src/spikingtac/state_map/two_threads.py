"""Work on many markers or events, divided between this thread and a second one.

What a kernel does with one part must not depend on the other, and the kernel must release the
interpreter's lock; then the result is the same bit by bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

MANY_MARKERS = 256
"""Fewer markers are fitted in the time in which a second thread wakes, 30 to 60 us (ours)."""

MANY_EVENTS = 16_384
"""Fewer events are absorbed within that time: one takes 8 ns (ours)."""

_pool: ThreadPoolExecutor | None = None
"""One thread for all trackers of the process, begun when it is first needed; trackers are copied,
and a thread cannot be."""


def worth_dividing(count: int, many: int) -> bool:
    """Return whether there are many of something, and a second core for a part of them."""
    return count >= many and _cores() > 1


def divide(count: int, work: Callable[[slice], None]) -> None:
    """Do the first half of the work here and the rest beside it.

    Args:
        count: Number of markers, events or rows.
        work: Is given those to work on; called twice, at the same time.
    """
    middle = count // 2
    beside = _second_thread().submit(work, slice(middle, count))
    work(slice(0, middle))
    beside.result()


def _second_thread() -> ThreadPoolExecutor:
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(1, "spikingtac-second")
    return _pool


def _forget() -> None:
    """Let a forked process begin a thread of its own; its parent's did not come along."""
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
