"""Writes events to files, and a manifest that tells what is missing.

What was taken is with the operating system at once, so that it survives the death of this process;
a full disk keeps what is on it. Events on disk and lost ones add up to what the camera delivered.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from spikingtac._version import package_version
from spikingtac.atomic_files import write_text
from spikingtac.errors import ConfigError, RecordingError, SpikingTacError
from spikingtac.events.evt.raw import RawSource, part_name
from spikingtac.events.evt.raw_writer import RawWriter
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.recording import MANIFEST, SCHEMA, name_of
from spikingtac.types import EventPacket

FIRST_NAME = "events.raw"
MANIFEST_S = 5.0  # Time between two manifests, s: what a killed recorder leaves is at most so old.
RESERVE = ".reserve.tmp"

# Space that is kept for the last manifest of a disk that runs full: one of 1,000 files fits.
RESERVE_BYTES = 1 << 18
US_PER_S = 1_000_000
_SPLIT = re.compile(r"(\d+(?:\.\d+)?)(MB|GB|s|min|h)")
_UNITS = {"MB": 10**6, "GB": 10**9, "s": US_PER_S, "min": 60 * US_PER_S, "h": 3600 * US_PER_S}


class Split(NamedTuple):
    """When the next file begins: at a size, or after a stretch of the sensor's time.

    Attributes:
        most_bytes: Size from which on the next file begins, bytes.
        most_us: Stretch that a file covers, us.
    """

    most_bytes: float = 1e9
    most_us: float = math.inf

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
        return cls(most_bytes=amount) if "B" in found[2] else cls(math.inf, amount)


BY_SIZE = Split()  # Files of 1 GB.


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


class Recorder:
    """Records packets into a folder until it is closed.

    Args:
        folder: An existing, empty folder.
        size: ``(width, height)`` of the sensor, px.
        ask: Returns what the manifest says of the camera.
        split: When the next file begins.
        sensor: Which sensor of the folder, from 0 on.

    Attributes:
        folder: As given.
        parts: The files so far, in order.
        about: What the manifest says of the camera.
        lost_events: Events that the disk was too slow for, or that it refused.
        failure: Why nothing more is written, or None.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        ask: Callable[[], dict[str, Any]] = dict,
        split: Split = BY_SIZE,
        sensor: int = 0,
    ) -> None:
        self.folder, self._size, self._split, self._sensor = folder, size, split, sensor
        self._ask = ask
        self._reserve = self.beside(RESERVE)
        # Real bytes: a sparse file reserves nothing.
        self._reserve.write_bytes(os.urandom(RESERVE_BYTES))
        self._started, self._described_s = time.time(), time.monotonic()
        self._writer: RawWriter | None = None
        self._digest, self._edges = hashlib.sha256(), Triggers()
        self.parts: list[Part] = []
        self.lost_events = 0
        self.failure: Exception | None = None
        self.describe()

    def beside(self, name: str) -> Path:
        """Return where this sensor's file of a name stands."""
        return self.folder / name_of(name, self._sensor)

    @property
    def written_events(self) -> int:
        """Events of all files."""
        return sum(part.events for part in self.parts)

    def write(self, packet: EventPacket, triggers: Triggers | None = None) -> None:
        """Write a packet, and the trigger edges in its time; nothing where the disk has failed."""
        if self.failure is not None:
            self.lost_events += len(packet)
            return
        try:
            self._edges.extend(triggers or Triggers())
            self._append(packet)
        except (OSError, SpikingTacError) as error:
            self._fail(error)
            self.lost_events += len(packet)
        if time.monotonic() - self._described_s >= MANIFEST_S:
            self.describe()

    def close(self, delivered_events: int) -> None:
        """Complete files and manifest.

        Args:
            delivered_events: What the camera delivered: what cannot be read of it is lost.
        """
        if self.failure is None:
            try:
                if not self.parts:  # a recording without any event has a file with its header
                    self._begin(0)
                self._complete()
            except (OSError, SpikingTacError) as error:
                self._fail(error)
        changed = self._recount()
        if changed is not None and self.failure is None:
            self.failure = RecordingError(f"{changed} was removed or changed meanwhile")
        self.lost_events = delivered_events - self.written_events
        self.describe(complete=self.failure is None)
        self._free_reserve()

    def _append(self, packet: EventPacket) -> None:
        """Append a packet that follows the ones before it in time."""
        if not len(packet):
            return
        first_us, last_us = int(packet.t[0]), int(packet.t[-1])
        if self._writer is not None:
            part = self.parts[-1]
            spanned_us = last_us - part.t_first_us
            if part.bytes >= self._split.most_bytes or spanned_us >= self._split.most_us:
                self._complete()
        writer = self._writer or self._begin(first_us)
        writer.add_triggers(self._edges)
        self._edges.clear()
        writer.write(packet)
        writer.flush()  # what is with the operating system survives this process
        part = self.parts[-1]
        part.bytes, part.t_last_us = writer.written_bytes, last_us
        part.events += len(packet)

    def _begin(self, first_us: int) -> RawWriter:
        name = part_name(name_of(FIRST_NAME, self._sensor), len(self.parts))
        self._digest = hashlib.sha256()
        self._writer = RawWriter(self.folder / name, self._size, in_place=True, digest=self._digest)
        self.parts.append(Part(name=name, t_first_us=first_us))
        self.describe()
        return self._writer

    def _complete(self) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        writer.flush(durable=True)
        writer.close()
        part = self.parts[-1]
        part.bytes, part.sha256 = writer.written_bytes, self._digest.hexdigest()
        self.describe()

    def _fail(self, error: Exception) -> None:
        """Close the file as it is; what reached the disk stays."""
        self.failure = error
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()

    def _recount(self) -> str | None:
        """Count again what a file holds that is gone, cut, or was not completed.

        Returns:
            The name of a completed file that is not what was written; None where all are.
        """
        changed = None
        for part in self.parts:
            path = self.folder / part.name
            size = path.stat().st_size if path.is_file() else 0
            if part.sha256 is not None and size == part.bytes:
                continue
            changed = part.name if part.sha256 is not None else changed
            part.events, part.bytes = 0, size
            with contextlib.suppress(OSError, SpikingTacError):
                part.events = sum(len(packet) for packet in RawSource(path, ReadOptions()))
        return changed

    def describe(self, complete: bool = False) -> None:
        """Write the manifest, whole each time, also when the disk is full."""
        self._described_s, self.about, parts = time.monotonic(), self._ask(), self.parts
        document = {
            "schema": SCHEMA,
            "source": "camera",
            "complete": complete,
            "failure": None if self.failure is None else str(self.failure),
            "size": list(self._size),
            "sensors": 1,
            "t_start_us": parts[0].t_first_us if parts else 0,
            "t_end_us": parts[-1].t_last_us + 1 if parts and parts[-1].events else 0,
            "events": self.written_events,
            "lost_events": self.lost_events,
            "files": [asdict(part) for part in parts],
            "started_unix_s": round(self._started, 6),
            "written_unix_s": round(time.time(), 6),
            "package_version": package_version(),
            "host": {  # no name of a machine or a person
                "system": platform.platform(),
                "python": platform.python_version(),
                # The clock of the mapping starts with the machine; this turns it into the time.
                "unix_minus_monotonic_s": time.time() - time.monotonic(),
            },
            **self.about,
        }
        text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
        with contextlib.suppress(OSError):  # the events matter more, and go on
            try:
                write_text(self.beside(MANIFEST), text)
            except OSError:
                self._free_reserve()
                write_text(self.beside(MANIFEST), text)

    def _free_reserve(self) -> None:
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)
