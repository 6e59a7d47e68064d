"""Ctrl-C on a camera: the first one ends its stream, so that the verb completes what it has."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ending_on_interrupt(source: object) -> Iterator[None]:
    """Close a live source at the first Ctrl-C; a second one interrupts as usual.

    Args:
        source: One with ``close()`` ends so; any other is interrupted at once.
    """
    close = getattr(source, "close", None)
    if close is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: Any) -> None:
        signal.signal(signal.SIGINT, before)
        close()

    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
