"""The option ``--realtime`` of verbs that read a camera: what it asks for, and what was granted."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from spikingtac.cli.messages import remark
from spikingtac.errors import ConfigError


def require_live(sources: Iterable[Path | str]) -> None:
    """Refuse ``--realtime`` for what has no deadline: a recording would take a core for itself.

    Raises:
        ConfigError: A source is a recording.
    """
    from spikingtac.events.evt.raw_stream import is_stream

    for source in sources:
        if not is_stream(Path(source)):
            raise ConfigError(
                f"{str(source)!r} is a recording and has no deadlines; --realtime is for cameras "
                "(an address, a named pipe, or -), leave it out"
            )


def ask_for_real_time() -> None:
    """Ask the system for what helps to keep deadlines, and tell what was granted."""
    from spikingtac.stream.real_time import meet_deadlines

    remark(meet_deadlines().text())
