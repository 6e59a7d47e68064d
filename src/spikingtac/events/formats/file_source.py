"""The part that all files have in common: iterate again, count, cut into packets, be strict."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from spikingtac.errors import ConfigError, DamageError
from spikingtac.events.formats.codec import HARMLESS, KINDS, Triggers
from spikingtac.events.formats.limits import SIDE_LIMIT_PX, require_size
from spikingtac.events.formats.packing import ColumnCheck, Packer, Rows
from spikingtac.events.source import HealthMeter
from spikingtac.types import EventPacket, LossCounters, SourceHealth

CHUNK_EVENTS = 1 << 17  # About how many events a packet holds by default.

# Sensors that are assumed where a file names no size: the first that holds its events.
SIZES_PX = ((320, 320), (346, 260), (640, 480), (1280, 720))

# Bytes that are searched at once for where reading goes on after damage, and the longest mark.
SEARCH_BYTES, MARK_BYTES = 1 << 20, 32

# Share of a file's events that may lie outside of the size that is read from them.
STRAY_SHARE = 1e-3


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How a file is to be read.

    Attributes:
        strict: Whether the first damage is an error (else it is mended and counted).
        chunk_events: About how many events a packet holds.
        encoding: Encoding of RAW words that overrides the header's, or None.
        size: ``(width, height)`` that overrides the file's, px, or None.
        sensor: Number of the camera to read, from 0 on; None for the only one.
    """

    strict: bool = False
    chunk_events: int = CHUNK_EVENTS
    encoding: str | None = None
    size: tuple[int, int] | None = None
    sensor: int | None = None


def chosen_sensor(names: list[str], sensor: int | None, path: Path) -> int:
    """Return which of several cameras in a file is read.

    Args:
        names: The cameras, in the order of their numbers.
        sensor: The one that was asked for; None where none was.
        path: The file, for errors.

    Raises:
        ConfigError: There is no such camera, or there are several and none was asked for.
    """
    if sensor is None and len(names) == 1:
        return 0
    if sensor is not None and 0 <= sensor < len(names):
        return sensor
    listed = ", ".join(f"{number} ({name})" for number, name in enumerate(names))
    given = "several cameras" if sensor is None else f"no sensor {sensor}"
    raise ConfigError(f"{str(path)!r} holds {given}; choose one with --sensor (sensor=): {listed}")


class FileSource:
    """Events of one file, as an :class:`~spikingtac.events.source.EventSource`.

    Each iteration begins at the start of the file and counts anew.

    Attributes:
        path: The file.
        format: Short name of the format.
        size: ``(width, height)`` of the sensor, px.
        losses: What was lost or mended in the latest iteration, by kind (see ``codec.KINDS``).
        triggers: Trigger edges met in the latest iteration; complete when it has ended.
        notes: What had to be assumed, in plain words.
        progress: Share of the file that the latest iteration has read, 0 to 1.
        lost_before: What was lost before the file was opened, as in a damaged archive around it.
    """

    format = "events"
    checked = False  # Whether columns come in order, on the sensor, of the package's types.

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path, self._options = path, options
        self.losses, self.triggers = LossCounters(), Triggers()
        self.notes: list[str] = []
        self.progress = 0.0
        self.lost_before: dict[str, int] = {}
        self._counters = HealthMeter(self.losses)
        self.size = require_size(options.size or self._size(), repr(str(path)))

    def _size(self) -> tuple[int, int]:
        """Return the sensor's size, from the file or from its events."""
        return self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        """Yield columns from the start of the file; count what is wrong."""
        raise NotImplementedError

    def columns(self) -> Iterator[Rows]:
        """Yield columns from the start of the file, not yet packed, and count what is wrong."""
        return self._columns()

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the file's packets.

        Raises:
            RecordingError: The file cannot be read.
            DamageError: Damage was found, and ``strict`` was asked for.
        """
        self.losses.clear()
        self.losses.update(self.lost_before)
        self.triggers.clear()
        self.progress = 0.0
        self._counters = HealthMeter(self.losses)
        packer = Packer(self.size, self._options.chunk_events)
        check = ColumnCheck(self.size, self.losses)
        for columns in self._columns():
            self._refuse_damage()
            yield from self._counted(packer.push(*(columns if self.checked else check(*columns))))
            self._refuse_damage()
        yield from self._counted(packer.push(*check.finish()))
        self._refuse_damage()
        yield from self._counted(packer.finish())
        self.progress = 1.0

    def counters(self) -> SourceHealth:
        """Return what the latest iteration has met so far; the rate is the mean one."""
        return self._counters.total()

    def _counted(self, packets: Iterable[EventPacket]) -> Iterator[EventPacket]:
        for packet in packets:
            self._counters.absorb(packet)
            yield packet

    def _refuse_damage(self) -> None:
        if not self._options.strict:
            return
        for kind, count in self.losses.kinds():
            if kind not in HARMLESS:
                raise DamageError(
                    f"{str(self.path)!r} is damaged: {kind} ({KINDS.get(kind, 'damage')}), "
                    f"{count} so far; read it without strict to keep what is sound"
                )

    def _size_from_events(self) -> tuple[int, int]:
        """Return the smallest usual sensor that holds nearly all events; say so in the notes."""
        seen = np.zeros((2, SIDE_LIMIT_PX), np.int64)
        self.size = (SIDE_LIMIT_PX, SIDE_LIMIT_PX)
        for columns in self._columns():
            for counts, column in zip(seen, columns, strict=False):
                within = column[(column >= 0) & (column < SIDE_LIMIT_PX)].astype(np.int64)
                counts += np.bincount(within, minlength=SIDE_LIMIT_PX)
        self.losses.clear()
        self.triggers.clear()
        if not seen.any():
            self.notes.append("no size and no events; assumed 320x320 px")
            return SIZES_PX[0]
        # The least length that holds all but a stray share of the addresses.
        covered = seen.cumsum(axis=1) >= (1 - STRAY_SHARE) * seen.sum(axis=1, keepdims=True)
        width, height = (covered.argmax(axis=1) + 1).tolist()
        usual = [size for size in SIZES_PX if width <= size[0] and height <= size[1]]
        size = usual[0] if usual else (width, height)
        self.notes.append(f"the file names no size; {size[0]}x{size[1]} px holds its events")
        return size


Read = Callable[[int, int], bytes]  # Returns up to so many bytes from a place on.


def reader_of(file: BinaryIO) -> Read:
    """Return what reads a file from any place."""

    def read(place: int, length: int) -> bytes:
        file.seek(place)
        return file.read(length)

    return read


def place_after_damage(
    read: Read, place: int, end: int, mark: re.Pattern[bytes], proven: Callable[[int], int | None]
) -> int | None:
    """Return where reading goes on after damage, or None where the rest holds nothing sound.

    Args:
        read: Reads the file.
        place: Where to begin to search.
        end: Length of the file, bytes.
        mark: What a piece may begin with.
        proven: Returns where the piece begins that a mark at a place belongs to, or None.
    """
    while place < end:
        for match in mark.finditer(read(place, SEARCH_BYTES + MARK_BYTES)):
            found = proven(place + match.start())
            if found is not None:
                return found
        place += SEARCH_BYTES
    return None
