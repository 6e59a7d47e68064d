"""Recordings from their beginning to their end: one or two cameras, a folder, and the disk."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_text
from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.recording import MANIFEST, TRUTH, name_of, read_manifest
from spikingtac.events.source import source_health
from spikingtac.stream.packets import at_once, new_ring
from spikingtac.stream.reader import EventReader
from spikingtac.stream.recorder import BY_SIZE, US_PER_S, Recorder, Split
from spikingtac.types import EventPacket

ROOM_BYTES = 256 << 20  # Memory for events that wait for the disk: 6 s at 3 Mev/s.
JOINED_EVENTS = 1 << 16  # Small packets are joined up to so many events before they are encoded.
WAIT_S = 0.02  # Longest wait for events before the recording looks at the time, s.
SHOW_S = 0.2  # Time between two reports of how the recording stands, s.
TIME_BASE = "time_base"  # Key of the second manifest: the map from its clock to the first sensor's.
SENSORS = 2  # Sensors that one folder holds at most.

# File that a recorder holds locked; the system releases it however the recorder ends.
LOCK = ".recording"


def record(
    sources: Sequence[CameraSource],
    folder: Path,
    *,
    split: Split = BY_SIZE,
    seconds: float = math.inf,
    room_bytes: int = ROOM_BYTES,
    show: Callable[[Sequence[Session]], object] = lambda sessions: None,
) -> dict[str, Any]:
    """Record one or two cameras until they end, are closed, or the time is up.

    Args:
        sources: The cameras; with ``when_lost="reconnect"`` one is waited for when it is gone.
        folder: An existing folder, see :func:`prepare_folder`.
        split: When the next file begins.
        seconds: How long to record from when the cameras are open, s.
        room_bytes: Memory for events that wait for the disk.
        show: Told how they stand, a few times a second.

    Returns:
        The summary of the first one: counts, files, camera, clock, losses, why it ended. Of two,
        ``second`` is that of the other, and ``time_base`` the map from the second clock to the
        first (None where a camera delivered nothing).
    """
    sessions: list[Session] = []
    begun_s = shown_s = time.monotonic()
    try:
        for number, source in enumerate(sources):
            sensors = 1 if number else len(sources)
            sessions.append(Session(source, folder, split, number, sensors, room_bytes))
        while any([session.step(WAIT_S / len(sessions)) for session in sessions]):
            now_s = time.monotonic()
            if now_s - begun_s >= seconds:
                for session in sessions:
                    session.end("seconds")
            if now_s - shown_s >= SHOW_S:
                shown_s = now_s
                show(sessions)
    finally:
        errors = [session.close() for session in sessions]
    for error in filter(None, errors):
        raise error
    told = [session.summary() for session in sessions]
    if len(sessions) == 1:
        return told[0]
    return {**told[0], "second": told[1], TIME_BASE: _noted(folder, *sources)}


def _noted(folder: Path, first: CameraSource, second: CameraSource) -> dict[str, Any] | None:
    """Write the map between the clocks into the second manifest, and return it."""
    base, own = first.clock.mapping(), second.clock.mapping()
    if base is None or own is None:
        return None
    found = own.then(base.inverse()).summary()
    path = folder / name_of(MANIFEST, 1)
    document = {**read_manifest(path), TIME_BASE: found}
    write_text(path, json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n")
    return found


class Session:
    """One camera, read in a thread, and its files.

    Args:
        source: The camera.
        folder: Where they go.
        split: When the next file begins.
        number: Which sensor of the folder, from 0 on.
        sensors: How many of them the manifest tells.
        room_bytes: Memory for events that wait for the disk.

    Attributes:
        source: As given.
        recorder: What is on disk, and what was lost.
    """

    def __init__(
        self,
        source: CameraSource,
        folder: Path,
        split: Split,
        number: int,
        sensors: int,
        room_bytes: int,
    ) -> None:
        self.source, self._sensors, self._ended = source, sensors, ""
        self._delivered: int | None = None
        self._error: BaseException | None = None
        settings = {"biases": source.camera.biases(), "roi": source.camera.roi()}
        self._settings = {name: values for name, values in settings.items() if values}
        self.recorder = Recorder(folder, source.size, self._about, split, number)
        self._truth: ColumnFile | None = None
        if fixed := source.camera.truth():  # of a simulation; a camera knows no truth
            self._truth = ColumnFile(self.recorder.beside(TRUTH))
            for name, values in fixed.items():
                self._truth.set(name, values)
            source.camera.take_truth = self._truth.append
        ring = new_ring(source.size, room_bytes)
        self._reader: EventReader | None = EventReader(at_once(source), source, ring)

    @property
    def missed(self) -> int:
        """Events that the disk was too slow for so far."""
        return self._reader.losses["missed"] if self._reader else 0

    def step(self, wait_s: float) -> bool:
        """Write what has come, after waiting if nothing has; return whether more may come."""
        if self._reader is None:
            return False
        packets: list[EventPacket] = []
        edges, events = Triggers(), 0
        try:
            found = self._reader.take(wait_s)
            while found is not None:
                packets.append(found.packet)
                events += len(found.packet)
                edges.extend(found.triggers)
                found = self._reader.take() if events < JOINED_EVENTS else None
        except Exception as error:  # raised once the files are complete
            self._error = None if isinstance(error, EOFError) else error
            self._delivered = self._reader.ring.weight
            self._reader.release()
            self._reader = None
        if packets:
            joined = packets[0] if len(packets) == 1 else EventPacket.concatenate(packets)
            self.recorder.write(joined, edges)
        if self.recorder.failure is not None:
            self.end("disk")
        return self._reader is not None

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
        self.recorder.close(self._delivered or 0)
        if self._truth is not None:
            self._truth.close()
        return self._error

    def summary(self) -> dict[str, Any]:
        """Return what was recorded."""
        disk = self.recorder
        filled = [part for part in disk.parts if part.events]
        span_us = filled[-1].t_last_us + 1 - filled[0].t_first_us if filled else 0
        return {
            "output": str(disk.folder),
            "ended": (self._ended or self.source.ended) if disk.failure is None else "disk",
            "failure": None if disk.failure is None else str(disk.failure),
            "seconds": round(span_us / US_PER_S, 3),  # of the recording's own time
            "events": disk.written_events,
            "lost_events": disk.lost_events,
            "bytes": sum(part.bytes for part in disk.parts),
            "files": len(disk.parts),
            **disk.about,
        }

    def _about(self) -> dict[str, Any]:
        """Return what the manifest says of the camera."""
        source, mapping = self.source, self.source.clock.mapping()
        delivery = source.health()
        told = delivery.summary()
        about = {"address": str(source.address), **source.camera.describe(), **self._settings}
        return {
            "camera": about,
            "losses": told.pop("losses"),
            "health": source_health(delivery.losses, delivery.rate_ev_s).summary(),
            "delivery": told,
            "clock": None if mapping is None else mapping.clock_summary(),
            "gaps": source.gaps,
            "sensors": self._sensors,
            **source.camera.manifest(),
            "received_events": self._delivered or told["events"],
        }


@contextmanager
def locked_folder(folder: Path, overwrite: bool) -> Iterator[None]:
    """Keep other recorders out of a folder meanwhile; make it where it is not there.

    Raises:
        ConfigError: A recording is there, and ``overwrite`` is not given; or it is no folder.
        DeviceError: Another program records into it.
    """
    recorded(folder, overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # another system than Linux and macOS: no lock
            pass
        except OSError as error:
            raise DeviceError(
                f"another program records into {str(folder)!r}; choose another folder"
            ) from error
        try:
            yield
        finally:
            with suppress(OSError):
                (folder / LOCK).unlink()
                folder.rmdir()  # where nothing was recorded


def prepare_folder(folder: Path, overwrite: bool) -> None:
    """Make a folder for a recording, or empty one of an earlier recording.

    Raises:
        ConfigError: A recording is there, and ``overwrite`` is not given; or it is no folder.
    """
    for path in recorded(folder, overwrite):
        path.unlink()
    folder.mkdir(parents=True, exist_ok=True)


def recorded(folder: Path, overwrite: bool) -> list[Path]:
    """Return the files of a recording that is there already, to be replaced.

    Raises:
        ConfigError: There are any, and ``overwrite`` is not given; or it is no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{str(folder)!r} is a file; name a folder for the recording")
    names = [name_of(first, sensor) for first in (MANIFEST, TRUTH) for sensor in range(SENSORS)]
    old = [*folder.glob("events*.raw"), *(folder / name for name in names)]
    old = [path for path in old if path.is_file()]
    if old and not overwrite:
        raise ConfigError(
            f"{str(folder)!r} holds a recording already; choose another folder, or give "
            "--overwrite to replace it"
        )
    return old
