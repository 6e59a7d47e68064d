"""Work on many markers or events, divided between this thread and a second one.

What a kernel does with one part must not depend on the other, and the kernel must release the
interpreter's lock; then the result is the same bit by bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

Part = TypeVar("Part")

PARTS = 4  # Parts of divided work: so few that handing them over costs little, 10 us each.

# One thread for all trackers of the process, begun when it is first needed; trackers are copied,
# and a thread cannot be.
_pool: ThreadPoolExecutor | None = None


def divide(count: int, work: Callable[[slice], Part]) -> list[Part]:
    """Do the first half of the work here and the rest beside it.

    What the second thread has not begun when this one is done is done here: on a busy machine it
    may get no turn for milliseconds.

    Args:
        count: Number of markers, events or rows.
        work: Is given those to work on; called several times, by both threads at the same time.

    Returns:
        What the work returned for each part, in the order of the parts: sums of them do not depend
        on which thread was faster.
    """
    edges = [count * part // PARTS for part in range(PARTS + 1)]
    parts = [slice(*ends) for ends in pairwise(edges)]
    pool, rest = _second_thread(), parts[PARTS // 2 :]
    beside = [(part, pool.submit(work, part)) for part in reversed(rest)]
    done = [work(part) for part in parts[: PARTS // 2]]
    for part, submitted in reversed(beside):  # the second thread begins with the others
        done.append(work(part) if submitted.cancel() else submitted.result())
    return done


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
