"""Writes what a camera delivers from a thread of its own, and counts what a slow disk made it drop.

Whoever delivers never waits. What was taken is handed to the operating system as soon as the disk
keeps up, so that it survives the death of this process; a full disk keeps what is on it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.cameras.recording.manifest import ManifestFile
from spikingtac.cameras.recording.segments import FIRST_NAME, Segments, Split
from spikingtac.errors import RecordingError, SpikingTacError
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.manifest import name_of
from spikingtac.types import EventPacket

MANIFEST_S = 5.0
"""Time between two manifests, s: what a killed recorder leaves is at most so old."""
EVENT_BYTES = 13
"""Memory of an event that waits: two coordinates, polarity, time."""
ROOM_BYTES = 512 << 20
"""Memory for events that wait for the disk: 13 s at 3 Mev/s."""
JOINED_EVENTS = 1 << 16
"""Small packets are joined up to so many events before they are encoded."""
LOST_GAPS = 1000
"""Stretches of lost events that are told one by one; later ones are counted only."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RecorderState:
    """How a recording stands.

    Attributes:
        written_events: Events on disk.
        written_bytes: Bytes on disk.
        parts: Files.
        lost_events: Events that were dropped because the disk was too slow, or is full.
        waiting_events: Events that wait for the disk.
        failure: Why nothing more is written, or None.
    """

    written_events: int
    written_bytes: int
    parts: int
    lost_events: int
    waiting_events: int
    failure: Exception | None


class Recorder:
    """Records packets into a folder until it is closed.

    Args:
        folder: An existing, empty folder.
        size: ``(width, height)`` of the sensor, px.
        split: When the next file begins.
        about: Called for what the manifest says of the camera; must not block for long.
        room_bytes: Memory for packets that wait for the disk.
        sensor: Which sensor of the folder, from 0 on.
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        split: Split | None = None,
        about: Callable[[], Mapping[str, Any]] = dict,
        room_bytes: int = ROOM_BYTES,
        sensor: int = 0,
    ) -> None:
        self._about = about
        self._manifest = ManifestFile(folder, size, sensor)
        name, describe = name_of(FIRST_NAME, sensor), lambda: self._describe(False)
        self._segments = Segments(folder, size, split or Split(), describe, name)
        self._room_events = room_bytes // EVENT_BYTES
        self._waiting: deque[EventPacket] = deque()
        self._edges = Triggers()
        self._waiting_events = self._lost_events = self._offered_events = 0
        self._gaps: list[tuple[int, int, int]] = []
        self._failure: Exception | None = None
        self._closing = False
        self._changed = threading.Condition()
        self._describe(False)
        self._thread = threading.Thread(target=self._run, name="spikingtac-recorder", daemon=True)
        self._thread.start()

    @property
    def state(self) -> RecorderState:
        """How the recording stands now."""
        return RecorderState(
            written_events=self._segments.written_events,
            written_bytes=self._segments.written_bytes,
            parts=len(self._segments.parts),
            lost_events=self._lost_events,
            waiting_events=self._waiting_events,
            failure=self._failure,
        )

    def offer(self, packet: EventPacket) -> bool:
        """Take a packet, or count it as lost; never waits for the disk.

        Returns:
            Whether it was taken.
        """
        count = len(packet)
        with self._changed:
            self._offered_events += count
            if self._failure is not None or self._waiting_events + count > self._room_events:
                self._lose(packet)
                return False
            self._waiting.append(packet)
            self._waiting_events += count
            self._changed.notify()
        return True

    def offer_triggers(self, triggers: Triggers) -> None:
        """Take trigger edges; they are written with the packet that is offered next."""
        with self._changed:
            self._edges.extend(triggers)

    def close(self) -> RecorderState:
        """Write what waits, complete files and manifest, and return the final state."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        return self.state

    def _lose(self, packet: EventPacket) -> None:
        self._lost_events += len(packet)
        if len(packet) and len(self._gaps) < LOST_GAPS:
            first_us, last_us = int(packet.t[0]), int(packet.t[-1])
            if self._gaps and first_us - self._gaps[-1][1] <= 1:
                start_us, _, lost = self._gaps.pop()
                self._gaps.append((start_us, packet.t_end_us, lost + len(packet)))
            else:
                self._gaps.append((first_us, max(packet.t_end_us, last_us + 1), len(packet)))

    def _run(self) -> None:
        try:
            self._write_all()
            self._segments.close()
        except (OSError, SpikingTacError) as error:
            self._fail(error)
            self._describe(False)
            with self._changed:  # what still comes is counted, and told by the last manifest
                self._changed.wait_for(lambda: self._closing)
        self._check()
        self._describe(self._failure is None)
        self._manifest.close()

    def _check(self) -> None:
        """Compare the files with what was written; what cannot be read is lost."""
        changed = self._segments.recount()
        if changed is not None and self._failure is None:
            self._failure = RecordingError(f"{changed} was removed or changed meanwhile")
        self._lost_events = self._offered_events - self._segments.written_events

    def _write_all(self) -> None:
        described_s = time.monotonic()
        while (packets := self._take(MANIFEST_S)) is not None:
            if packets:
                joined = packets[0] if len(packets) == 1 else EventPacket.concatenate(packets)
                with self._changed:
                    self._waiting_events -= len(joined)
                    edges, self._edges = self._edges, Triggers()
                try:
                    self._segments.add_triggers(edges)
                    self._segments.write(joined)
                except BaseException:
                    self._lose(joined)
                    raise
            if time.monotonic() - described_s >= MANIFEST_S:
                self._describe(False)
                described_s = time.monotonic()

    def _take(self, timeout_s: float) -> list[EventPacket] | None:
        """Return the packets that wait, joined up to a size; None once all is written."""
        with self._changed:
            if not self._waiting and not self._closing:
                self._changed.wait(timeout_s)
            if not self._waiting:
                return None if self._closing else []
            packets, events = [], 0
            while self._waiting and events < JOINED_EVENTS:
                packets.append(self._waiting.popleft())
                events += len(packets[-1])
            return packets

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self._failure = error
            for packet in self._waiting:
                self._lose(packet)
            self._waiting.clear()
            self._waiting_events = 0
        self._segments.abandon()

    def _describe(self, complete: bool) -> None:
        fields = {
            "complete": complete,
            "parts": self._segments.parts,
            "gaps_lost": self._gaps,
            "lost_events": self._lost_events,
            "failure": None if self._failure is None else str(self._failure),
        }
        with contextlib.suppress(OSError):  # the events matter more, and go on
            self._manifest.write(fields, self._about())
