"""A camera's events on disk, and a manifest that tells what is missing.

What was taken is with the operating system at once, so that it survives the death of this process;
a full disk keeps what is on it. Events on disk and lost ones add up to what the camera delivered.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.atomic_files import write_text
from spikingtac.errors import RecordingError, SpikingTacError
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.evt.raw import RawSource, part_name
from spikingtac.events.evt.raw_writer import RawWriter
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.recording import MANIFEST, SCHEMA, TRUTH, name_of
from spikingtac.events.source import source_health
from spikingtac.file_kinds import RECORDING_NAME
from spikingtac.stream.packets import at_once, new_ring
from spikingtac.stream.reader import EventReader
from spikingtac.types import US_PER_S, EventPacket

ROOM_BYTES = 256 << 20  # Memory for events that wait for the disk: 6 s at 3 Mev/s.
JOINED_EVENTS = 1 << 16  # Small packets are joined up to so many events before they are encoded.
WAIT_S = 0.02  # Longest wait for events before the recording looks at the time, s.
TIME_BASE = "time_base"  # Key of the second manifest: the map from its clock to the first sensor's.
MANIFEST_S = 5.0  # Time between two manifests, s: what a killed recorder leaves is at most so old.
RESERVE = ".reserve.tmp"

# Space that is kept for the last manifest of a disk that runs full: one of 1,000 files fits.
RESERVE_BYTES = 1 << 18


class Recorder:
    """Records a camera, which a thread reads, into a folder until it is closed.

    Args:
        sources: The cameras of the folder.
        number: Which of them, from 0 on.
        folder: An existing folder.
        split: Size, bytes, and stretch of the sensor's time, us, from which on a file is complete.

    Attributes:
        source: The camera.
    """

    def __init__(
        self, sources: Sequence[CameraSource], number: int, folder: Path, split: tuple[float, float]
    ) -> None:
        self.source, self._sources, self._number = sources[number], sources, number
        self._folder, (self._most_bytes, self._most_us) = folder, split
        self._ended, self._delivered = "", 0
        self._error: BaseException | None = None  # what ended the camera
        self._failure: Exception | None = None  # why nothing more is written
        source, camera = self.source, self.source.camera
        settings = {"biases": camera.biases(), "roi": camera.roi()}
        self._settings = {name: values for name, values in settings.items() if values}
        self._reserve = self._beside(RESERVE)
        # Real bytes: a sparse file reserves nothing.
        self._reserve.write_bytes(os.urandom(RESERVE_BYTES))
        self._started = time.time()
        self._parts: list[dict[str, Any]] = []  # the files, as the manifest tells them
        self._writer: RawWriter | None = None
        self._digest, self._edges = hashlib.sha256(), Triggers()
        self._truth: ColumnFile | None = None
        if fixed := camera.truth():  # of a simulation; a camera knows no truth
            self._truth = ColumnFile(self._beside(TRUTH))
            for name, values in fixed.items():
                self._truth.set(name, values)
            camera.take_truth = self._truth.append
        ring = new_ring(source.size, ROOM_BYTES)
        self._reader: EventReader | None = EventReader(at_once(source), source, ring)
        self._describe()

    @property
    def missed(self) -> int:
        """Events that the disk was too slow for so far."""
        return self._reader.losses["missed"] if self._reader else 0

    def step(self, wait_s: float) -> bool:
        """Write what has come, after waiting if nothing has; return whether more may come."""
        if self._reader is None:
            return False
        packets: list[EventPacket] = []
        events = 0
        try:
            found = self._reader.take(wait_s)
            while found is not None:
                packets.append(found.packet)
                events += len(found.packet)
                self._edges.extend(found.triggers)
                found = self._reader.take() if events < JOINED_EVENTS else None
        except Exception as error:  # raised once the files are complete
            self._error = None if isinstance(error, EOFError) else error
            self._delivered = self._reader.ring.weight
            self._reader.release()
            self._reader = None
        if events:
            self.write(packets[0] if len(packets) == 1 else EventPacket.concatenate(packets))
        if self._failure is not None:
            self.end("disk")
        return self._reader is not None

    def write(self, packet: EventPacket) -> None:
        """Write a packet that follows the ones before it in time, where the disk takes it."""
        if self._failure is None:
            try:
                self._append(packet)
            except (OSError, SpikingTacError) as error:
                self._fail(error)
        if time.monotonic() - self._described_s >= MANIFEST_S:
            self._describe()

    def end(self, why: str = "") -> None:
        """End the camera soon, and say why."""
        if self._reader is not None:
            self._ended = self._ended or why
            self.source.close()

    def close(self) -> BaseException | None:
        """Take what has come by now, complete the files, and return what ended the camera."""
        self.end()
        while self.step(WAIT_S):
            pass
        self.source.release()
        if self._failure is None:
            try:
                if not self._parts:  # a recording without any event has a file with its header
                    self._begin(0)
                self._complete()
            except (OSError, SpikingTacError) as error:
                self._fail(error)
        changed = self._recount()
        if changed is not None and self._failure is None:
            self._failure = RecordingError(f"{changed} was removed or changed meanwhile")
        self._describe(complete=self._failure is None)
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)
        if self._truth is not None:
            self._truth.close()
        return self._error

    def summary(self) -> dict[str, Any]:
        """Return what was recorded."""
        filled = [part for part in self._parts if part["events"]]
        span_us = filled[-1]["t_last_us"] + 1 - filled[0]["t_first_us"] if filled else 0
        return {
            "output": str(self._folder),
            "ended": "disk" if self._failure is not None else self._ended or self.source.ended,
            "seconds": round(span_us / US_PER_S, 3),  # of the recording's own time
            "bytes": sum(part["bytes"] for part in self._parts),
            "files": len(self._parts),
            **self._counted(),
            **self._told,
        }

    def _beside(self, name: str) -> Path:
        """Return where this sensor's file of a name stands."""
        return self._folder / name_of(name, self._number)

    def _append(self, packet: EventPacket) -> None:
        first_us, last_us = int(packet.t[0]), int(packet.t[-1])
        if self._writer is not None:
            part = self._parts[-1]
            spanned_us = last_us - part["t_first_us"]
            if part["bytes"] >= self._most_bytes or spanned_us >= self._most_us:
                self._complete()
        writer = self._writer or self._begin(first_us)
        writer.add_triggers(self._edges)
        self._edges.clear()
        writer.write(packet)
        writer.flush()  # what is with the operating system survives this process
        part = self._parts[-1]
        part["bytes"], part["t_last_us"] = writer.written_bytes, last_us
        part["events"] += len(packet)

    def _begin(self, first_us: int) -> RawWriter:
        path = self._beside(RECORDING_NAME)
        path = path.with_name(part_name(path.name, len(self._parts)))
        self._digest = hashlib.sha256()
        self._writer = RawWriter(path, self.source.size, in_place=True, digest=self._digest)
        part = {"name": path.name, "t_first_us": first_us, "t_last_us": 0}
        self._parts.append({**part, "events": 0, "bytes": 0, "sha256": None})
        self._describe()
        return self._writer

    def _complete(self) -> None:
        writer, self._writer = self._writer, None
        assert writer is not None
        writer.flush(durable=True)
        writer.close()
        self._parts[-1] |= {"bytes": writer.written_bytes, "sha256": self._digest.hexdigest()}
        self._describe()

    def _fail(self, error: Exception) -> None:
        """Close the file as it is; what reached the disk stays."""
        self._failure = error
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()

    def _recount(self) -> str | None:
        """Count again the events of changed and incomplete files; return a changed one's name."""
        changed = None
        for part in self._parts:
            path = self._folder / part["name"]
            size = path.stat().st_size if path.is_file() else 0
            if part["sha256"] is not None and size == part["bytes"]:
                continue
            changed = part["name"] if part["sha256"] is not None else changed
            part["events"], part["bytes"] = 0, size
            with contextlib.suppress(OSError, SpikingTacError):
                part["events"] = sum(len(packet) for packet in RawSource(path, ReadOptions()))
        return changed

    def _counted(self) -> dict[str, Any]:
        """Return what is on disk, and what is lost: in the end, all that is not on disk."""
        events = sum(part["events"] for part in self._parts)
        return {
            "failure": None if self._failure is None else str(self._failure),
            "events": events,
            "lost_events": self.missed if self._reader else self._delivered - events,
        }

    def _describe(self, complete: bool = False) -> None:
        """Write the manifest, whole each time, also when the disk is full."""
        self._described_s, self._told, parts = time.monotonic(), self._about(), self._parts
        document = {
            "schema": SCHEMA,
            "source": "camera",
            "complete": complete,
            "size": list(self.source.size),
            "t_start_us": parts[0]["t_first_us"] if parts else 0,
            "t_end_us": parts[-1]["t_last_us"] + 1 if parts and parts[-1]["events"] else 0,
            "files": parts,
            "started_unix_s": round(self._started, 6),
            "written_unix_s": round(time.time(), 6),
            "package_version": package_version(),
            "host": {  # no name of a machine or a person
                "system": platform.platform(),
                "python": platform.python_version(),
                # The clock of the mapping starts with the machine; this turns it into the time.
                "unix_minus_monotonic_s": time.time() - time.monotonic(),
            },
            **self._counted(),
            **self._told,
        }
        text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
        with contextlib.suppress(OSError):  # the events matter more, and go on
            try:
                write_text(self._beside(MANIFEST), text)
            except OSError:
                self._reserve.unlink(missing_ok=True)
                write_text(self._beside(MANIFEST), text)

    def _about(self) -> dict[str, Any]:
        """Return what the manifest says of the camera."""
        source, mapping = self.source, self.source.clock.mapping()
        delivery, address = source.health(), str(source.address)
        told = delivery.summary()
        about = {
            "camera": {"address": address, **source.camera.describe(), **self._settings},
            "losses": told.pop("losses"),
            "health": source_health(delivery.losses, delivery.rate_ev_s).summary(),
            "delivery": told,
            "clock": None if mapping is None else mapping.clock_summary(),
            "gaps": source.gaps,
            "sensors": 1 if self._number else len(self._sources),
            **source.camera.manifest(),
            "received_events": self._delivered or told["events"],
        }
        base = self._sources[0].clock.mapping() if self._number else None
        if mapping is not None and base is not None:
            about[TIME_BASE] = mapping.then(base.inverse()).summary()
        return about
