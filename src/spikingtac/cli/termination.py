"""SIGTERM ends a verb that drives an arm as Ctrl-C does: what was opened is closed, and brakes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_TERMINATED = 143
"""128 + SIGTERM, what a shell reports of a program that was terminated."""


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Turn SIGTERM into SystemExit while the context lasts; Python would end without closing."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may choose
        return
    former = signal.signal(signal.SIGTERM, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, former)


def _end(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not end the braking
    raise SystemExit(EXIT_TERMINATED)
