"""Create event files: the ending picks the format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from spikingtac import plugins
from spikingtac.errors import ConfigError, nearest
from spikingtac.events.formats.codec import EventWriter
from spikingtac.plugins import with_plugins

# Ending -> module and class that writes it.
_WRITERS = {
    ".raw": ("evt.raw_writer", "RawWriter"),
    ".npz": ("tables.writers", "NpzWriter"),
    ".csv": ("tables.writers", "TextWriter"),
    ".txt": ("tables.writers", "TextWriter"),
    ".h5": ("tables.hdf5_writer", "Hdf5Writer"),
    ".hdf5": ("tables.hdf5_writer", "Hdf5Writer"),
    ".aedat4": ("tables.writers", "Aedat4Writer"),
}
WRITABLE = tuple(_WRITERS)


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
    if ending in _WRITERS:
        module, name = _WRITERS[ending]
        arguments = (path, size, encoding or "evt3") if ending == ".raw" else (path, size)
        return getattr(import_module(f"spikingtac.events.{module}"), name)(*arguments)
    foreign = with_plugins({}, plugins.WRITERS)
    if ending.removeprefix(".") in foreign:
        return foreign[ending.removeprefix(".")](path, size)
    raise ConfigError(
        f"cannot write {ending!r} files{nearest(ending, WRITABLE)} (valid: {', '.join(WRITABLE)})"
    )
