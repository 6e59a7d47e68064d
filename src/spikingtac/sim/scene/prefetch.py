"""Prefetch: a thread prepares the next items while the caller uses the present one."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Generator, Iterable
from typing import TypeVar, cast

T = TypeVar("T")

_POLL_S = 0.05
"""Time after which a producer with a full queue checks whether the caller has left, s."""


def prefetch(items: Iterable[T], depth: int) -> Generator[T, None, None]:
    """Yield the items in order while a thread prepares up to ``depth`` of them.

    An exception of the producer is raised here at the place of the item. The thread ends with the
    iteration, also if the caller ends it early.

    Args:
        items: Items to prepare.
        depth: Number of items in the queue.
    """
    ready: queue.Queue[object] = queue.Queue(depth)
    left = threading.Event()
    end = object()

    def put(item: object) -> None:
        while not left.is_set():
            with contextlib.suppress(queue.Full):
                return ready.put(item, timeout=_POLL_S)

    def produce() -> None:
        try:
            for item in items:
                put(item)
                if left.is_set():
                    return
        except BaseException as error:  # handed to the caller, who raises it
            put(_Failure(error))
        put(end)

    worker = threading.Thread(target=produce, name="spikingtac-prefetch", daemon=True)
    worker.start()
    try:
        while (item := ready.get()) is not end:
            if isinstance(item, _Failure):
                raise item.error
            yield cast(T, item)
    finally:
        left.set()
        worker.join()


class _Failure:
    def __init__(self, error: BaseException) -> None:
        self.error = error
