"""The other finger's recording on the first one's clock."""

from __future__ import annotations

from pathlib import Path

from spikingtac.events.clocks.recorded import clock_beside
from spikingtac.events.clocks.retimed import RetimedSource
from spikingtac.events.formats.file_source import FileSource, ReadOptions
from spikingtac.events.open import open_events


def is_same_folder(first: Path, second: Path) -> bool:
    """Return whether two paths are one folder: then its second sensor is meant."""
    return first.is_dir() and second.is_dir() and first.samefile(second)


def open_second(first: Path, second: Path, *, strict: bool = False) -> tuple[FileSource, bool]:
    """Open the other finger's recording.

    Args:
        first: Recording whose clock is the time base.
        second: The other one; the same folder again means its second sensor.
        strict: As of :func:`~spikingtac.events.open.open_events`.

    Returns:
        The events, and whether their times are known to be on the first one's clock: else they are
        as the recording tells them.

    Raises:
        RecordingError: It cannot be read.
    """
    if is_same_folder(first, second):
        return open_events(first, strict=strict, sensor=1), True
    source = open_events(second, strict=strict)
    base, own = clock_beside(first), clock_beside(second)
    time_map = None if base is None or own is None else own.on(base)
    if time_map is None:
        return source, False
    return RetimedSource(source, time_map, ReadOptions(strict=strict)), True
