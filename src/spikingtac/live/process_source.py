"""A source that runs in a process of its own, a bounded stretch ahead of its reader.

A simulated sensor costs about as much as a tracker; side by side in one process they would share an
interpreter lock and neither would keep up.
"""

from __future__ import annotations

import multiprocessing
import queue
import signal
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from spikingtac.errors import SpikingTacError
from spikingtac.types import EventPacket, LossCounters

ITEMS_AHEAD = 256
"""Packets that wait to be read: 0.5 s of a simulation that steps at 500 Hz."""
POLL_S = 0.1
SHUTDOWN_S = 2.0

Maker = Callable[..., Iterable[tuple[EventPacket, Any]]]
"""Yields packets with what belongs to them; a function of a module, called with keywords."""


class ProcessSource:
    """An :class:`~spikingtac.events.source.EventSource` whose packets are made in another process.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: Nothing is lost on the way; what the maker loses it tells by its companions.
    """

    def __init__(
        self,
        maker: Maker,
        arguments: dict[str, Any],
        size: tuple[int, int],
        companion: Callable[[Any], None] = lambda _: None,
    ) -> None:
        """Start making.

        Args:
            maker: Yields ``(packet, companion)``.
            arguments: Its keyword arguments; they travel to the other process.
            size: Of the packets.
            companion: Is given each packet's companion before the packet is.
        """
        context = multiprocessing.get_context("spawn")
        self.size, self.losses = size, LossCounters()
        self._companion = companion
        self._items = context.Queue(ITEMS_AHEAD)
        self._process = context.Process(
            target=_make, args=(maker, arguments, self._items), daemon=True
        )
        self._process.start()

    def __iter__(self) -> Iterator[EventPacket]:
        while (item := self._next()) is not None:
            if isinstance(item, Exception):
                raise item
            packet, companion = item
            self._companion(companion)
            yield packet

    def close(self) -> None:
        """Stop the other process."""
        self._process.terminate()
        self._process.join(SHUTDOWN_S)
        self._items.cancel_join_thread()
        self._items.close()

    def _next(self) -> Any:
        while True:
            try:
                return self._items.get(timeout=POLL_S)
            except queue.Empty:
                if not self._process.is_alive() and self._items.empty():
                    return RuntimeError("the process that makes the events has ended")


def _make(maker: Maker, arguments: dict[str, Any], items: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the reader decides when to stop
    parent = multiprocessing.parent_process()

    def put(item: Any) -> None:
        while parent is None or parent.is_alive():
            try:
                return items.put(item, timeout=POLL_S)
            except queue.Full:
                continue
        raise SystemExit  # nobody is left to read

    try:
        for item in maker(**arguments):
            put(item)
        put(None)
    except Exception as error:  # handed to the reader, who raises it
        known = isinstance(error, SpikingTacError | OSError)
        put(error if known else RuntimeError(f"{type(error).__name__}: {error}"))
