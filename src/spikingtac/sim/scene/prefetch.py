"""Work ahead: let a thread prepare the next items while the caller uses the present one."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Generator, Iterable
from typing import TypeVar, cast

T = TypeVar("T")

_POLL_S = 0.05
"""How long a full queue is waited for before looking whether the caller has left."""


def prefetch(items: Iterable[T], depth: int) -> Generator[T, None, None]:
    """Yield the same items in the same order, up to ``depth`` of them prepared in a thread.

    What an item raises is raised here in its place. The thread ends with the iteration, also where
    the caller leaves early.
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

    worker = threading.Thread(target=produce, name="spikingtac-ahead", daemon=True)
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
