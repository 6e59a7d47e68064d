"""Ctrl-C on a camera: the first one ends its stream, so that the verb completes what it has."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ending_on_interrupt(*sources: object) -> Iterator[None]:
    """Close live sources at the first Ctrl-C; a second one interrupts as usual.

    Args:
        *sources: Those with ``close()`` end so; where none has it, the work is interrupted at once.
    """
    closes = [close for source in sources if (close := getattr(source, "close", None)) is not None]
    if not closes or threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: Any) -> None:
        signal.signal(signal.SIGINT, before)
        for close in closes:
            close()

    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
