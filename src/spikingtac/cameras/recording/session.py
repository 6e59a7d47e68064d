"""One recording from its beginning to its end: a camera, the disk, and the viewers of a copy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spikingtac.cameras.recording.copy import LiveCopy
from spikingtac.cameras.recording.recorder import ROOM_BYTES, Recorder, RecorderState
from spikingtac.cameras.recording.segments import Split
from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.cameras.health import CameraHealth
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.formats.array_file import ColumnFile
from spikingtac.events.formats.packing import ColumnCheck
from spikingtac.events.manifest import MANIFEST, TRUTH, name_of
from spikingtac.events.source_health import source_health
from spikingtac.types import EventPacket

DESCRIBE_S = 1.0
"""Time between two looks at the camera for the manifest, s."""
SENSORS = 2
"""Sensors that one folder holds at most."""
LOCK = ".recording"
"""File that a recorder holds locked; the system releases it however the recorder ends."""
SHOW_S = 0.2
"""Time between two reports of progress, s."""


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """How to record.

    Attributes:
        split: When the next file begins.
        seconds: How long to record from when the camera is open, s.
        copy: Named pipe for a live copy, or None.
        room_bytes: Memory for events that wait for the disk.
        sensor: Which sensor of the folder, from 0 on.
        sensors: How many sensors are recorded into the folder.
    """

    split: Split = field(default_factory=Split)
    seconds: float = math.inf
    copy: Path | None = None
    room_bytes: int = ROOM_BYTES
    sensor: int = 0
    sensors: int = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """How a recording stands, for the screen.

    Attributes:
        seconds: Since the camera was open, s.
        disk: What is on disk, and what waits or was lost.
        camera: How the camera delivers.
        copy_lost: Events that the live copy's reader did not take.
    """

    seconds: float
    disk: RecorderState
    camera: CameraHealth
    copy_lost: int


def record(
    source: CameraSource,
    folder: Path,
    options: RecordOptions | None = None,
    show: Callable[[Progress], object] = lambda progress: None,
) -> dict[str, Any]:
    """Record a camera until it ends, is closed, or the time is up.

    Args:
        source: The camera; with ``when_lost="reconnect"`` it is waited for when it is gone.
        folder: An existing folder, see :func:`prepare_folder`.
        options: How to record.
        show: Told how it stands, a few times a second.

    Returns:
        The summary: counts, files, camera, clock, losses, why it ended.
    """
    return _Session(source, folder, options or RecordOptions(), show).run()


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


class _Session:
    def __init__(
        self,
        source: CameraSource,
        folder: Path,
        options: RecordOptions,
        show: Callable[[Progress], object],
    ) -> None:
        self._source, self._folder, self._options, self._show = source, folder, options, show
        settings = {"biases": source.camera.biases(), "roi": source.camera.roi()}
        self._settings = {name: values for name, values in settings.items() if values}
        self._begun_s = self._ended_s = time.monotonic()
        self._described_s = self._shown_s = 0.0
        self._received = 0
        self._about: dict[str, Any] = self._described()
        self._recorder = Recorder(
            folder,
            source.size,
            options.split,
            lambda: self._about,
            options.room_bytes,
            options.sensor,
        )
        self._copy = LiveCopy(options.copy, source.size) if options.copy else None
        self._truth = _truth_file(source, folder / name_of(TRUTH, options.sensor))

    def run(self) -> dict[str, Any]:
        self._source.on_poll = self._tick
        passed = 0
        try:
            for packet in self._packets():
                self._received += len(packet)
                edges = self._source.triggers
                if len(edges) > passed:
                    self._recorder.offer_triggers(edges.select(slice(passed, None)))
                    passed = len(edges)
                self._recorder.offer(packet)
                if self._copy is not None:
                    self._copy.offer(packet)
        finally:
            self._ended_s = time.monotonic()
            self._source.release()
            self._about = self._described()
            state = self._recorder.close()
            if self._copy is not None:
                self._copy.close()
            if self._truth is not None:
                self._truth.close()
        return self._summary(state)

    def _packets(self) -> Iterator[EventPacket]:
        """Yield what came at once: nothing is held back, as a packet for a tracker would be."""
        source = self._source
        check = None if source.checked else ColumnCheck(source.size, source.losses)
        for rows in source.columns():
            x, y, p, t = rows if check is None else check(*rows)
            if len(t):
                columns = (x.copy(), y.copy(), p.copy(), t.copy())
                yield EventPacket(*columns, int(t[0]), int(t[-1]) + 1, source.size, True)
        if check is not None:
            x, y, p, t = check.finish()
            if len(t):
                yield EventPacket(x, y, p, t, int(t[0]), int(t[-1]) + 1, source.size, True)

    def _tick(self) -> None:
        now_s = time.monotonic()
        if now_s - self._shown_s >= SHOW_S:
            self._shown_s = now_s
            self._show(self._progress(now_s))
        if now_s - self._described_s >= DESCRIBE_S:
            self._described_s = now_s
            self._about = self._described()
        if (
            now_s - self._begun_s >= self._options.seconds
            or self._recorder.state.failure is not None
        ):
            self._source.close()

    def _progress(self, now_s: float) -> Progress:
        return Progress(
            seconds=now_s - self._begun_s,
            disk=self._recorder.state,
            camera=self._source.health(),
            copy_lost=0 if self._copy is None else self._copy.lost_events,
        )

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
            "clock": None if mapping is None else mapping.summary(),
            "gaps": [gap._asdict() for gap in source.gaps],
            **({"sensors": self._options.sensors} if self._options.sensor == 0 else {}),
            **source.camera.manifest(),
            "received_events": self._received,
        }

    def _summary(self, state: RecorderState) -> dict[str, Any]:
        return {
            "output": str(self._folder),
            "ended": "disk" if state.failure is not None else self._ended(),
            "failure": None if state.failure is None else str(state.failure),
            "seconds": round(self._ended_s - self._begun_s, 3),
            "events": state.written_events,
            "lost_events": state.lost_events,
            "bytes": state.written_bytes,
            "files": state.parts,
            "copy_lost_events": 0 if self._copy is None else self._copy.lost_events,
            **self._about,
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
