"""The part that all files have in common: iterate again, count, cut into packets, be strict."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spikingtac.errors import ConfigError, DamageError, FormatError
from spikingtac.events.formats.codec import KINDS, Triggers
from spikingtac.events.formats.packing import ColumnCheck, Packer, Rows
from spikingtac.events.source import HARMLESS, HealthMeter
from spikingtac.schema import LARGEST, convert_fields, require_within
from spikingtac.types import EventPacket, LossCounters, SourceHealth

CHUNK_EVENTS = 1 << 17  # About how many events a packet holds by default.

# Sensors that are assumed where a file names no size: the first that holds its events.
SIZES_PX = ((320, 320), (346, 260), (640, 480), (1280, 720))

SIDE_LIMIT_PX = 1 << 16  # Columns and rows that a coordinate of two bytes can name.

# Largest sensor that is believed, px: 16 megapixels; a map of it takes 64 MB (the largest event
# sensor on the market has one).
AREA_LIMIT_PX = 1 << 24

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

    def __post_init__(self) -> None:
        convert_fields(self)
        require_within(self, chunk_events=(1, LARGEST))


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
    _named_size: tuple[int, int] | None = None  # What the file says; readers set it first.
    checked = False  # Whether columns come in order, on the sensor, of the package's types.

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path, self._options = path, options
        self.losses, self.triggers = LossCounters(), Triggers()
        self.notes: list[str] = []
        self.progress = 0.0
        self.lost_before: dict[str, int] = {}
        self._counters = HealthMeter(self.losses)
        width, height = self.size = options.size or self._size()
        longest, area = max(width, height), width * height
        if min(width, height) < 1 or longest > SIDE_LIMIT_PX or area > AREA_LIMIT_PX:
            raise (ConfigError if options.size else FormatError)(
                f"{str(path)!r}: a sensor of {width}x{height} px is not possible (valid: 1 "
                f"to {SIDE_LIMIT_PX} a side, {AREA_LIMIT_PX} px together); give the true size: "
                "spikingtac convert IN OUT --size WxH (in Python size=)"
            )

    def _size(self) -> tuple[int, int]:
        """Return the sensor's size: as the file names it, else from its events."""
        return self._named_size or self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        """Yield columns from the start of the file; count what is wrong."""
        raise NotImplementedError

    def columns(self) -> Iterator[Rows]:
        """Yield columns from the start of the file, not yet packed, and count what is wrong."""
        return self._columns()

    def _chunks(self, start: int, length: int) -> Iterator[bytes]:
        """Yield the bytes of the file from a place on, so many at once."""
        total = max(self.path.stat().st_size, 1)
        with self.path.open("rb") as file:
            file.seek(start)
            while data := file.read(length):
                self.progress = file.tell() / total
                yield data

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
        for packet in self._sound_packets():
            self._counters.absorb(packet)
            yield packet
        self.progress = 1.0

    def counters(self) -> SourceHealth:
        """Return what the latest iteration has met so far; the rate is the mean one."""
        return self._counters.total()

    def _sound_packets(self) -> Iterator[EventPacket]:
        packer = Packer(self.size, self._options.chunk_events)
        check = ColumnCheck(self.size, self.losses)
        for columns in self._columns():
            sound = columns if self.checked else check(*columns)
            self._refuse_damage()
            yield from packer.push(*sound)
        yield from packer.push(*check.finish())
        self._refuse_damage()
        yield from packer.finish()

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
