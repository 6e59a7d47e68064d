"""How a verb ends and keeps time on a camera: Ctrl-C, SIGTERM, and the option ``--realtime``."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spikingtac.cli.messages import remark
from spikingtac.errors import ConfigError

EXIT_TERMINATED = 143  # 128 + SIGTERM, what a shell reports of a program that was terminated.


@contextmanager
def ending_on_interrupt(*sources: object) -> Iterator[None]:
    """Close live sources at the first Ctrl-C; a second one interrupts as usual.

    Args:
        *sources: Those with ``close()`` end so; where none has it, the work is interrupted at once.
    """
    closes = [close for source in sources if (close := getattr(source, "close", None)) is not None]

    def end(*_: Any) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for close in closes:
            close()

    with _on_signal(signal.SIGINT, end if closes else None):
        yield


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Turn SIGTERM into SystemExit while the context lasts, so that what was opened is closed.

    A verb that drives an arm then brakes it; Python by itself would end without closing.
    """

    def end(*_: Any) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not end the braking
        raise SystemExit(EXIT_TERMINATED)

    with _on_signal(signal.SIGTERM, end):
        yield


@contextmanager
def _on_signal(number: signal.Signals, handler: Any) -> Iterator[None]:
    """Handle a signal while the context lasts; only the main thread may."""
    if handler is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def require_live(sources: Iterable[Path | str]) -> None:
    """Refuse ``--realtime`` for what has no deadline: a recording would take a core for itself.

    Raises:
        ConfigError: A source is a recording.
    """
    from spikingtac.events.address import is_stream

    for source in sources:
        if not is_stream(Path(source)):
            raise ConfigError(
                f"{str(source)!r} is a recording and has no deadlines; --realtime is for cameras "
                "(an address, a named pipe, or -), leave it out"
            )


def ask_for_real_time() -> None:
    """Ask the system for what helps to keep deadlines, and tell what was granted."""
    from spikingtac.stream.real_time import meet_deadlines

    remark(meet_deadlines())
