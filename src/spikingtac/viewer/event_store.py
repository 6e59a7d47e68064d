"""Events on disk with random access in time, so that a replay needs little memory."""

from __future__ import annotations

import os
import tempfile
import time
import weakref
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.source import EventSource
from spikingtac.types import EventPacket

# Events that the files hold before they grow; they double, and stay sparse on disk.
FIRST_CAPACITY = 1 << 20
COLUMNS = {"x": np.uint16, "y": np.uint16, "p": np.bool_, "t": np.int64}


class EventStore:
    """Stores every event of a source in temporary files, and returns any stretch of time.

    A source that goes on (a camera, a simulation) is pulled only as far as is asked for.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: What the source has lost so far, by kind.
        ended: True once the source has nothing more.
        waited_s: Time spent waiting for the source so far, s.
        t_start_us: First microsecond of the stream.
        t_end_us: First microsecond that was not pulled yet.
    """

    def __init__(self, source: EventSource) -> None:
        self.size, self.losses = source.size, source.losses
        self.ended, self.waited_s = False, 0.0
        self.t_start_us = self.t_end_us = 0
        self._stream: Iterator[EventPacket] = iter(source)
        self._columns: dict[str, NDArray[Any]] = {}
        self._events = 0
        self._begun = False
        # Files without a name: nothing is left of them, even where the process is killed.
        opened = ExitStack()
        made = ((name, tempfile.TemporaryFile()) for name in COLUMNS)  # noqa: SIM115
        self._files = {name: opened.enter_context(file) for name, file in made}
        self._close_files = weakref.finalize(self, opened.close)
        self._grow(FIRST_CAPACITY)
        self._pull()

    @property
    def first_event_us(self) -> int | None:
        """Time of the first event, or None while none has been pulled."""
        return int(self._columns["t"][0]) if self._events else None

    def around(self, t_us: int) -> tuple[int | None, int | None]:
        """Return the times of the last event before ``t_us`` and of the next one from it on.

        None stands for an event that is not there, or was not pulled yet.
        """
        times_us = self._columns["t"][: self._events]
        place = int(np.searchsorted(times_us, t_us))
        last_us = int(times_us[place - 1]) if place else None
        return last_us, int(times_us[place]) if place < len(times_us) else None

    def __len__(self) -> int:
        return self._events

    def extend_to(self, t_us: float) -> bool:
        """Pull the source until it covers ``t_us``; False where it ends before.

        Args:
            t_us: A time, us; infinity pulls everything of a source that ends.
        """
        while not self.ended and self.t_end_us < t_us:
            self._pull()
        return self.t_end_us >= t_us

    def between(self, t_start_us: int, t_end_us: int) -> EventPacket:
        """Return the events of ``[t_start_us, t_end_us)`` among those that were pulled (views)."""
        times_us = self._columns["t"][: self._events]
        first, last = np.searchsorted(times_us, (t_start_us, t_end_us))
        x, y, p, t = (self._columns[name][first:last] for name in COLUMNS)
        return EventPacket(x, y, p, t, t_start_us, t_end_us, self.size)

    def close(self) -> None:
        """Remove the temporary files; packets that were returned stay valid."""
        self._columns.clear()
        self._close_files()

    def _pull(self) -> None:
        asked_s = time.perf_counter()
        try:
            packet = next(self._stream, None)
        finally:
            self.waited_s += time.perf_counter() - asked_s
        if packet is None:
            self.ended = True
            return
        if not self._begun:
            self._begun, self.t_start_us = True, packet.t_start_us
        self.t_end_us = packet.t_end_us
        after = self._events + len(packet)
        if after > len(self._columns["t"]):
            self._grow(max(after, 2 * len(self._columns["t"])))
        for name, column in self._columns.items():
            column[self._events : after] = getattr(packet, name)
        self._events = after

    def _grow(self, capacity: int) -> None:
        for name, dtype in COLUMNS.items():
            file = self._files[name]
            os.truncate(file.fileno(), capacity * np.dtype(dtype).itemsize)
            # asarray: slices of np.memmap itself cost microseconds each.
            self._columns[name] = np.asarray(np.memmap(file, dtype, mode="r+", shape=(capacity,)))
