"""Create event files: the ending picks the format."""

from __future__ import annotations

from pathlib import Path

from spikingtac import plugins
from spikingtac.errors import ConfigError, nearest
from spikingtac.events.formats.codec import EventWriter
from spikingtac.plugins import with_plugins

WRITABLE = (".raw", ".npz", ".csv", ".txt", ".h5", ".hdf5", ".aedat4")
"""Endings that can be written."""


def create_events(
    path: str | Path, size: tuple[int, int], *, encoding: str | None = None
) -> EventWriter:
    """Open a file for writing events, packet by packet, at constant memory.

    The same events give the same bytes on every machine and day, wherever the packets are cut.

    Args:
        path: File to write; its ending picks the format.
        size: ``(width, height)`` of the sensor, px.
        encoding: For ``.raw``: ``evt3`` (the default), ``evt21`` or ``evt2``.

    Raises:
        ConfigError: The ending or the encoding is unknown.
        FormatError: The sensor does not fit into the format.
        MissingExtraError: The format needs a library of the extra ``[formats]``.
    """
    ending = Path(path).suffix.lower()
    if encoding is not None and ending != ".raw":
        raise ConfigError(f"encoding={encoding!r} is for .raw files, not for {ending!r}")
    if ending == ".raw":
        from spikingtac.events.evt.raw_writer import RawWriter

        return RawWriter(path, size, encoding or "evt3")
    if ending == ".npz":
        from spikingtac.events.tables.writers import NpzWriter

        return NpzWriter(path, size)
    if ending in (".csv", ".txt"):
        from spikingtac.events.tables.writers import TextWriter

        return TextWriter(path, size)
    if ending in (".h5", ".hdf5"):
        from spikingtac.events.tables.hdf5_writer import Hdf5Writer

        return Hdf5Writer(path, size)
    if ending == ".aedat4":
        from spikingtac.events.tables.writers import Aedat4Writer

        return Aedat4Writer(path, size)
    foreign = with_plugins({}, plugins.WRITERS)
    if ending.removeprefix(".") in foreign:
        return foreign[ending.removeprefix(".")](path, size)
    raise ConfigError(
        f"cannot write {ending!r} files{nearest(ending, WRITABLE)} (valid: {', '.join(WRITABLE)})"
    )
