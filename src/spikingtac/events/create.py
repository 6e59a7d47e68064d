"""Create event files: the ending picks the format."""

from __future__ import annotations

from pathlib import Path

from spikingtac.errors import ConfigError, nearest
from spikingtac.events.formats.codec import EventWriter

WRITABLE = (".raw",)
"""Endings that can be written."""


def create_events(
    path: str | Path, size: tuple[int, int], *, encoding: str | None = None
) -> EventWriter:
    """Open a file for writing events, packet by packet, at constant memory.

    The same events give the same bytes on every machine and day, wherever the packets are cut.

    Args:
        path: File to write; ``.raw``.
        size: ``(width, height)`` of the sensor, px.
        encoding: For ``.raw``: ``evt3`` (the default), ``evt21`` or ``evt2``.

    Raises:
        ConfigError: The ending or the encoding is unknown.
        FormatError: The sensor does not fit into the format.
    """
    ending = Path(path).suffix.lower()
    if ending == ".raw":
        from spikingtac.events.formats.raw_writer import RawWriter

        return RawWriter(path, size, encoding or "evt3")
    raise ConfigError(
        f"cannot write {ending!r} files{nearest(ending, WRITABLE)} (valid: {', '.join(WRITABLE)})"
    )
