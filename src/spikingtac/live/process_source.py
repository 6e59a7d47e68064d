"""A source that runs in a process of its own, a bounded stretch ahead of its reader.

A simulated sensor costs about as much as a tracker; side by side in one process they would share an
interpreter lock and neither would keep up.
"""

from __future__ import annotations

import multiprocessing
import queue
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from spikingtac.errors import RecordingError, SpikingTacError
from spikingtac.live.factory import Factory
from spikingtac.live.real_time import ordinary_priority
from spikingtac.types import EventPacket, LossCounters

ITEMS_AHEAD = 256
"""Packets that wait to be read: 0.5 s of a simulation that steps at 500 Hz."""
POLL_S = 0.1
SHUTDOWN_S = 2.0

INHERITING = "fork" if sys.platform == "linux" else "spawn"
"""How a process starts that needs what its parent has imported: without importing it again (0.7 s
for a simulated sensor, and 0.3 s until Numba is ready). Elsewhere a fork is not safe."""

Stream = Iterable[tuple[EventPacket, Any]]
"""Packets, each with side data that belong to it (or None)."""


class ProcessSource:
    """An :class:`~spikingtac.events.source.EventSource` whose packets come from another process.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: Nothing is lost between the processes; losses of the stream are in its side data.
    """

    def __init__(
        self,
        open_stream: Factory[Stream],
        size: tuple[int, int] | None,
        take_side_data: Callable[[Any], None] = lambda _: None,
        *,
        start_method: str = "spawn",
    ) -> None:
        """Start the other process.

        Args:
            open_stream: Opens the stream, in the other process.
            size: Size of the packets, ``(width, height)``, px; where it is None, the stream
                begins with a packet that tells it, and is not passed on.
            take_side_data: Called with each packet's side data before the packet is yielded.
            start_method: ``spawn``, or :data:`INHERITING` while this process has one thread.

        Raises:
            RecordingError: The stream ended before it told its size.
            SpikingTacError: It could not be opened, where its size was not known.
        """
        context = multiprocessing.get_context(start_method)
        self.losses = LossCounters()
        self._take_side_data = take_side_data
        self._items = context.Queue(ITEMS_AHEAD)
        # Annotated, since contexts have no common type for their processes.
        self._process: Any = context.Process(  # type: ignore[attr-defined]
            target=_make, args=(open_stream, self._items), daemon=True
        )
        self._process.start()
        self.size = size or self._told_size()

    def __iter__(self) -> Iterator[EventPacket]:
        while (item := self._next()) is not None:
            if isinstance(item, Exception):
                raise item
            packet, side_data = item
            self._take_side_data(side_data)
            yield packet

    @ordinary_priority()
    def close(self) -> None:
        """Stop the other process."""
        self._process.terminate()
        self._process.join(SHUTDOWN_S)
        self._items.cancel_join_thread()
        self._items.close()

    def _told_size(self) -> tuple[int, int]:
        item = self._next()
        if item is None or isinstance(item, Exception):
            self.close()
            raise item or RecordingError("the stream ended before it began; start its writer first")
        return item[0].size

    def _next(self) -> Any:
        while True:
            try:
                return self._items.get(timeout=POLL_S)
            except queue.Empty:
                if not self._process.is_alive() and self._items.empty():
                    return RuntimeError("the process that makes the events has ended")


def _make(open_stream: Factory[Stream], items: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the reader decides when to stop
    parent = multiprocessing.parent_process()

    def put(item: Any) -> None:
        while parent is None or parent.is_alive():
            try:
                return items.put(item, timeout=POLL_S)
            except queue.Full:
                continue
        raise SystemExit  # the reader is gone

    try:
        for item in open_stream():
            put(item)
        put(None)
    except Exception as error:  # sent to the reader, which raises it
        known = isinstance(error, SpikingTacError | OSError)
        put(error if known else RuntimeError(f"{type(error).__name__}: {error}"))
