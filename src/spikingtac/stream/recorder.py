"""Writes what a ring's user takes: events to files, and a manifest that tells what is missing.

What was taken is with the operating system at once, so that it survives the death of this process;
a full disk keeps what is on it. Events on disk and lost ones add up to what the camera delivered.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.atomic_files import write_text
from spikingtac.errors import RecordingError, SpikingTacError
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.manifest import MANIFEST, SCHEMA, name_of
from spikingtac.stream.segments import FIRST_NAME, Segments, Split
from spikingtac.types import EventPacket

MANIFEST_S = 5.0  # Time between two manifests, s: what a killed recorder leaves is at most so old.
LOST_GAPS = 1000  # Stretches of lost events that are told one by one; later ones are counted only.
RESERVE = ".reserve"

# Space that is kept for the last manifest of a disk that runs full: one of 1,000 files fits.
RESERVE_BYTES = 1 << 18


@dataclass(frozen=True, kw_only=True, slots=True)
class RecorderState:
    """How a recording stands.

    Attributes:
        written_events: Events on disk.
        written_bytes: Bytes on disk.
        parts: Files.
        lost_events: Events that the disk was too slow for, or that it refused.
        failure: Why nothing more is written, or None.
    """

    written_events: int
    written_bytes: int
    parts: int
    lost_events: int
    failure: Exception | None


class Recorder:
    """Records packets into a folder until it is closed.

    Args:
        folder: An existing, empty folder.
        size: ``(width, height)`` of the sensor, px.
        split: When the next file begins.
        about: Called for what the manifest says of the camera.
        sensor: Which sensor of the folder, from 0 on.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        split: Split | None = None,
        about: Callable[[], Mapping[str, Any]] = dict,
        sensor: int = 0,
    ) -> None:
        self._about, self._size = about, size
        self._path = folder / name_of(MANIFEST, sensor)
        self._reserve = folder / f"{RESERVE}{sensor or ''}"
        # Real bytes: a sparse file reserves nothing.
        self._reserve.write_bytes(os.urandom(RESERVE_BYTES))
        name, describe = name_of(FIRST_NAME, sensor), lambda: self._describe(False)
        self._segments = Segments(folder, size, split or Split(), describe, name)
        self._started, self._described_s = time.time(), time.monotonic()
        self._last_us = self._lost_events = 0
        self._gaps: list[tuple[int, int, int]] = []
        self._failure: Exception | None = None
        self._describe(False)

    @property
    def state(self) -> RecorderState:
        """How the recording stands now."""
        return RecorderState(
            written_events=self._segments.written_events,
            written_bytes=self._segments.written_bytes,
            parts=len(self._segments.parts),
            lost_events=self._lost_events,
            failure=self._failure,
        )

    def write(self, packet: EventPacket, triggers: Triggers | None = None) -> None:
        """Write a packet, and the trigger edges in its time; nothing where the disk has failed."""
        if self._failure is not None:
            self.lose(len(packet), packet.t_end_us)
            return
        try:
            if triggers is not None:
                self._segments.add_triggers(triggers)
            self._segments.write(packet)
            self._last_us = packet.t_end_us
        except (OSError, SpikingTacError) as error:
            self._failure = error
            self.lose(len(packet), packet.t_end_us)
            self._segments.abandon()
        if time.monotonic() - self._described_s >= MANIFEST_S:
            self._describe(False)

    def lose(self, events: int, until_us: int) -> None:
        """Count events that are missing between the last packet and a time, us."""
        self._lost_events += events
        if events and self._gaps and self._gaps[-1][1] >= self._last_us:
            start_us, _, lost = self._gaps.pop()
            self._gaps.append((start_us, until_us, lost + events))
        elif events and len(self._gaps) < LOST_GAPS:
            self._gaps.append((self._last_us, until_us, events))
        self._last_us = max(self._last_us, until_us)

    def close(self, delivered_events: int) -> RecorderState:
        """Complete files and manifest, and return the final state.

        Args:
            delivered_events: What the camera delivered: what cannot be read of it is lost.
        """
        if self._failure is None:
            try:
                self._segments.close()
            except (OSError, SpikingTacError) as error:
                self._failure = error
                self._segments.abandon()
        changed = self._segments.recount()
        if changed is not None and self._failure is None:
            self._failure = RecordingError(f"{changed} was removed or changed meanwhile")
        self._lost_events = delivered_events - self._segments.written_events
        self._describe(self._failure is None)
        self._free_reserve()
        return self.state

    def _describe(self, complete: bool) -> None:
        """Write the manifest, whole each time, also when the disk is full."""
        self._described_s = time.monotonic()
        parts = self._segments.parts
        document = {
            "schema": SCHEMA,
            "source": "camera",
            "complete": complete,
            "failure": None if self._failure is None else str(self._failure),
            "size": list(self._size),
            "sensors": 1,
            "t_start_us": parts[0].t_first_us if parts else 0,
            "t_end_us": parts[-1].t_last_us + 1 if parts and parts[-1].events else 0,
            "events": sum(part.events for part in parts),
            "lost_events": self._lost_events,
            "lost": [
                {"t_from_us": first, "t_to_us": last, "events": events}
                for first, last, events in self._gaps
            ],
            "files": [asdict(part) for part in parts],
            "started_unix_s": round(self._started, 6),
            "written_unix_s": round(time.time(), 6),
            "package_version": package_version(),
            "host": host(),
            **self._about(),
        }
        text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
        with contextlib.suppress(OSError):  # the events matter more, and go on
            try:
                write_text(self._path, text)
            except OSError:
                self._free_reserve()
                write_text(self._path, text)

    def _free_reserve(self) -> None:
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)


def host() -> dict[str, Any]:
    """Return what the machine and its clocks are; no name of a machine or a person."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "processors": os.cpu_count(),
        # The clock of the mapping starts with the machine: this turns it into the time of day.
        "unix_minus_monotonic_s": time.time() - time.monotonic(),
    }
