"""Small packets in a row, with losses and trigger edges, for whoever reads streams."""

import time
from collections.abc import Iterator

import numpy as np

from spikingtac.events.formats.codec import Triggers
from spikingtac.types import EventPacket, LossCounters

SIZE = (12, 10)


def packet(number: int, events: int = 100) -> EventPacket:
    t = 10_000 * number + np.arange(events, dtype=np.int64)
    x, y = (t % 12).astype(np.uint16), (t % 10).astype(np.uint16)
    return EventPacket(x, y, x > y, t, int(t[0]), int(t[-1]) + 1, SIZE)


class Stream:
    """Packets with losses and trigger edges; an error at the end where one is given."""

    def __init__(self, count: int, error: Exception | None = None, pause_s: float = 0.0) -> None:
        self.size, self.losses, self.triggers = SIZE, LossCounters(), Triggers()
        self._count, self._error, self._pause_s = count, error, pause_s

    def __iter__(self) -> Iterator[EventPacket]:
        for number in range(self._count):
            time.sleep(self._pause_s)
            if number % 3 == 2:
                self.losses.add("gap")
                self.triggers.append(10_000 * number, 1, True)
            yield packet(number)
        if self._error is not None:
            raise self._error
