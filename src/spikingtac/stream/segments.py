"""RAW files of one recording, each begun anew at a size or a time; what was written stays."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.events.evt.raw import RawSource, part_name
from spikingtac.events.evt.raw_writer import RawWriter
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.types import EventPacket

US_PER_S = 1_000_000
FIRST_NAME = "events.raw"
_SPLIT = re.compile(r"(\d+(?:\.\d+)?)(MB|GB|s|min|h)")
_UNITS = {"MB": 10**6, "GB": 10**9, "s": US_PER_S, "min": 60 * US_PER_S, "h": 3600 * US_PER_S}


@dataclass(frozen=True, kw_only=True)
class Split:
    """When the next file begins: at a size, or after a stretch of the sensor's time.

    Attributes:
        most_bytes: Size from which on the next file begins, bytes; None for any.
        most_us: Stretch that a file covers, us; None for any.
    """

    most_bytes: int | None = 10**9
    most_us: int | None = None

    @classmethod
    def parse(cls, text: str) -> Split:
        """Return the split that a text means, as ``500MB``, ``2GB``, ``60s``, ``10min``, ``1h``.

        Raises:
            ConfigError: It means none.
        """
        found = _SPLIT.fullmatch(text)
        amount = float(found[1]) * _UNITS[found[2]] if found else 0.0
        if found is None or amount < 1.0:
            raise ConfigError(
                f"--split is {text!r}; give a size (500MB, 2GB) or a duration (60s, 10min, 1h)"
            )
        if found[2] in ("MB", "GB"):
            return cls(most_bytes=round(amount))
        return cls(most_bytes=None, most_us=round(amount))


@dataclass(kw_only=True)
class Part:
    """One file of a recording, for its manifest.

    Attributes:
        name: Of the file.
        t_first_us: Time of its first event, us.
        t_last_us: Time of its last event, us.
        events: Events in it.
        bytes: Its size.
        sha256: Of its content once it is complete; None before.
    """

    name: str
    t_first_us: int = 0
    t_last_us: int = 0
    events: int = 0
    bytes: int = 0
    sha256: str | None = None


@dataclass
class _Open:
    writer: RawWriter
    part: Part
    digest: Any = field(default_factory=hashlib.sha256)


class Segments:
    """Appends packets to the current file and begins the next one when it is time.

    Args:
        folder: Where the files are; it exists.
        size: ``(width, height)`` of the sensor, px.
        split: When the next file begins.
        on_part: Called after a file was begun or completed.
        first_name: Name of the first file.

    Attributes:
        parts: The files so far, in order.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        split: Split,
        on_part: Callable[[], None] = lambda: None,
        first_name: str = FIRST_NAME,
    ) -> None:
        self._first_name = first_name
        self.parts: list[Part] = []
        self._folder, self._size, self._split, self._on_part = folder, size, split, on_part
        self._open: _Open | None = None
        self._edges = Triggers()

    @property
    def written_bytes(self) -> int:
        """Bytes of all files."""
        return sum(part.bytes for part in self.parts)

    @property
    def written_events(self) -> int:
        """Events of all files."""
        return sum(part.events for part in self.parts)

    def add_triggers(self, triggers: Triggers) -> None:
        """Take trigger edges, to be written with the packet that follows."""
        self._edges.extend(triggers)

    def write(self, packet: EventPacket) -> None:
        """Append a packet that follows the ones before it in time.

        Raises:
            OSError: The disk is full, or gone.
        """
        if not len(packet):
            return
        first_us, last_us = int(packet.t[0]), int(packet.t[-1])
        if self._open is not None and self._is_due(self._open.part, last_us):
            self._complete()
        if self._open is None:
            self._begin(first_us)
        opened = self._open
        assert opened is not None
        opened.writer.add_triggers(self._edges)
        self._edges.clear()
        opened.writer.write(packet)
        opened.writer.flush()  # what is with the operating system survives this process
        part = opened.part
        part.bytes = opened.writer.written_bytes
        part.events += len(packet)
        part.t_last_us = last_us

    def close(self) -> None:
        """Complete the current file; a recording without any event has one with its header."""
        if not self.parts:
            self._begin(0)
        self._complete()

    def abandon(self) -> None:
        """Close the file as it is; what reached the disk stays."""
        if self._open is not None:
            with contextlib.suppress(OSError):
                self._open.writer.close()
            self._open = None

    def recount(self) -> str | None:
        """Count again what a file holds that is gone, cut, or was not completed.

        Returns:
            The name of a completed file that is not what was written; None where all are.
        """
        changed = None
        for part in self.parts:
            path = self._folder / part.name
            size = path.stat().st_size if path.is_file() else 0
            if part.sha256 is not None and size == part.bytes:
                continue
            changed = part.name if part.sha256 is not None else changed
            part.events, part.bytes = _readable_events(path), size
        return changed

    def _is_due(self, part: Part, t_us: int) -> bool:
        split = self._split
        full = split.most_bytes is not None and part.bytes >= split.most_bytes
        return full or (split.most_us is not None and t_us - part.t_first_us >= split.most_us)

    def _begin(self, first_us: int) -> None:
        part = Part(name=part_name(self._first_name, len(self.parts)), t_first_us=first_us)
        digest = hashlib.sha256()
        path = self._folder / part.name
        writer = RawWriter(path, self._size, in_place=True, digest=digest)
        self._open = _Open(writer, part, digest)
        self.parts.append(part)
        self._on_part()

    def _complete(self) -> None:
        opened, self._open = self._open, None
        if opened is None:
            return
        opened.writer.flush(durable=True)
        opened.writer.close()
        opened.part.bytes = opened.writer.written_bytes
        opened.part.sha256 = opened.digest.hexdigest()
        self._on_part()


def _readable_events(path: Path) -> int:
    try:
        return sum(len(packet) for packet in RawSource(path, ReadOptions()))
    except (OSError, SpikingTacError):
        return 0
