"""Recordings from their beginning to their end: one or two cameras, and the disk."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_text
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.delivery import CameraHealth
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.manifest import MANIFEST, TRUTH, name_of, read_manifest
from spikingtac.events.source import source_health
from spikingtac.stream.packets import at_once, new_ring
from spikingtac.stream.reader import EventReader
from spikingtac.stream.recorder import Recorder, RecorderState
from spikingtac.stream.segments import Split
from spikingtac.types import EventPacket

ROOM_BYTES = 256 << 20  # Memory for events that wait for the disk: 9 s at 3 Mev/s.
JOINED_EVENTS = 1 << 16  # Small packets are joined up to so many events before they are encoded.
WAIT_S = 0.02  # Longest wait for events before the recording looks at the time, s.
DESCRIBE_S = 1.0  # Time between two looks at the camera for the manifest, s.
SHOW_S = 0.2  # Time between two reports of progress, s.
TIME_BASE = "time_base"  # Key of the second manifest: the map from its clock to the first sensor's.


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """How to record.

    Attributes:
        split: When the next file begins.
        seconds: How long to record from when the camera is open, s.
        room_bytes: Memory for events that wait for the disk.
    """

    split: Split = field(default_factory=Split)
    seconds: float = math.inf
    room_bytes: int = ROOM_BYTES


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """How a recording stands, for the screen.

    Attributes:
        seconds: Since the camera was open, s.
        disk: What is on disk, and what was lost.
        camera: How the camera delivers.
    """

    seconds: float
    disk: RecorderState
    camera: CameraHealth


def record(
    sources: Sequence[CameraSource],
    folder: Path,
    options: RecordOptions | None = None,
    show: Callable[[Sequence[Progress]], object] = lambda progress: None,
) -> dict[str, Any]:
    """Record one or two cameras until they end, are closed, or the time is up.

    Args:
        sources: The cameras; with ``when_lost="reconnect"`` one is waited for when it is gone.
        folder: An existing folder, see :func:`prepare_folder`.
        options: How to record.
        show: Told how they stand, a few times a second.

    Returns:
        The summary of the first one: counts, files, camera, clock, losses, why it ended. Of two,
        ``second`` is that of the other, and ``time_base`` the map from the second clock to the
        first (None where a camera delivered nothing).
    """
    given, shown_s = options or RecordOptions(), 0.0
    sessions: list[_Session] = []
    try:
        for number, source in enumerate(sources):
            sessions.append(_Session(source, folder, given, number, len(sources)))
        for session in sessions:
            session.begin()
        while any([session.step(WAIT_S / len(sessions)) for session in sessions]):
            if time.monotonic() - shown_s >= SHOW_S:
                shown_s = time.monotonic()
                show([session.progress() for session in sessions])
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


class _Session:
    """One camera, read in a thread, and its files."""

    def __init__(
        self,
        source: CameraSource,
        folder: Path,
        options: RecordOptions,
        sensor: int,
        sensors: int,
    ) -> None:
        self._source, self._folder, self._options = source, folder, options
        settings = {"biases": source.camera.biases(), "roi": source.camera.roi()}
        self._fixed = {} if sensor else {"sensors": sensors}
        self._settings = {name: values for name, values in settings.items() if values}
        self._begun_s = self._ended_s = self._described_s = time.monotonic()
        self._delivered = self._missed = 0
        self._error: BaseException | None = None
        self._about: dict[str, Any] = self._described()
        self._recorder = Recorder(folder, source.size, options.split, lambda: self._about, sensor)
        self._truth = _truth_file(source, folder / name_of(TRUTH, sensor))
        self._ring = new_ring(source.size, options.room_bytes)
        self._going = True
        self._reader: EventReader | None = None

    def begin(self) -> None:
        """Begin to read: of two cameras both at once, since their clocks meet at the host's."""
        self._begun_s = time.monotonic()
        self._reader = EventReader.in_thread(at_once(self._source), self._source, self._ring)

    def step(self, wait_s: float) -> bool:
        """Write what has come, after waiting if nothing has; return whether more may come."""
        if not self._going or self._reader is None:
            return False
        try:
            self._take(self._reader, wait_s)
        except EOFError:
            self._going = False
        except Exception as error:  # raised once the files are complete
            self._error, self._going = error, False
        now_s = time.monotonic()
        if now_s - self._described_s >= DESCRIBE_S:
            self._described_s = now_s
            self._about = self._described()
        over = now_s - self._begun_s >= self._options.seconds
        if over or self._recorder.state.failure is not None:
            self._source.close()
        return self._going

    def close(self) -> BaseException | None:
        """Take what has come by now, complete the files, and return what ended the camera."""
        self._source.close()
        while self.step(WAIT_S):
            pass
        self._ended_s = time.monotonic()
        if self._reader is not None:
            self._delivered = self._reader.ring.weight
            self._recorder.lose(self._reader.lost_events - self._missed, 0)
            self._reader.release()
        self._source.release()
        self._about = self._described()
        self._recorder.close(self._delivered)
        if self._truth is not None:
            self._truth.close()
        return self._error

    def progress(self) -> Progress:
        """Return how the recording stands."""
        return Progress(
            seconds=time.monotonic() - self._begun_s,
            disk=self._recorder.state,
            camera=self._source.health(),
        )

    def summary(self) -> dict[str, Any]:
        """Return what was recorded."""
        state = self._recorder.state
        return {
            "output": str(self._folder),
            "ended": "disk" if state.failure is not None else self._ended(),
            "failure": None if state.failure is None else str(state.failure),
            "seconds": round(self._ended_s - self._begun_s, 3),
            "events": state.written_events,
            "lost_events": state.lost_events,
            "bytes": state.written_bytes,
            "files": state.parts,
            **self._about,
        }

    def _take(self, reader: EventReader, wait_s: float) -> None:
        """Write the packets that are there, joined up to a size."""
        packets: list[EventPacket] = []
        edges, events = Triggers(), 0
        try:
            found = reader.take(wait_s)
            while found is not None:
                missed = reader.lost_events - self._missed
                if missed:
                    self._write(packets, edges)
                    packets, edges, events = [], Triggers(), 0
                    self._missed += missed
                    self._recorder.lose(missed, found.packet.t_start_us)
                packets.append(found.packet)
                events += len(found.packet)
                edges.extend(found.triggers)
                found = reader.take() if events < JOINED_EVENTS else None
        finally:
            self._write(packets, edges)

    def _write(self, packets: list[EventPacket], edges: Triggers) -> None:
        if packets:
            joined = packets[0] if len(packets) == 1 else EventPacket.concatenate(packets)
            self._recorder.write(joined, edges)

    def _described(self) -> dict[str, Any]:
        """Return what the manifest says of the camera."""
        source, mapping = self._source, self._source.clock.mapping()
        delivery = source.health()
        told = delivery.summary()
        return {
            "camera": {
                "address": str(source.address),
                **source.camera.describe(),
                **self._settings,
            },
            "losses": told.pop("losses"),
            "health": source_health(delivery.losses, delivery.rate_ev_s).summary(),
            "delivery": told,
            "clock": None if mapping is None else mapping.clock_summary(),
            "gaps": [gap._asdict() for gap in source.gaps],
            **self._fixed,
            **source.camera.manifest(),
            "received_events": self._delivered or told["events"],
        }

    def _ended(self) -> str:
        over = self._ended_s - self._begun_s >= self._options.seconds
        return "seconds" if over else self._source.ended


def _truth_file(source: CameraSource, path: Path) -> ColumnFile | None:
    """Return the growing ``truth.npz`` of a simulation; None for a camera, which knows no truth."""
    fixed = source.camera.truth()
    if not fixed:
        return None
    file = ColumnFile(path)
    for name, values in fixed.items():
        file.set(name, values)
    source.camera.take_truth = file.append
    return file
