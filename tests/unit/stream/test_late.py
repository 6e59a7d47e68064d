"""A live sensor whose work is late goes on with the newest events, and tells what it left out."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from spikingtac.stream.paced import PacedSource
from spikingtac.types import EventPacket, LossCounters

SPAN_S, EVENTS = 0.005, 10


class Camera:
    """Packets that wait, as in a socket's buffer, from the moment on that they are due."""

    size, path = (12, 10), Path("udp:7777")

    def __init__(self, count: int) -> None:
        self.losses, self._count = LossCounters(), count

    def __iter__(self) -> Iterator[EventPacket]:
        zero_s, flat = time.monotonic(), np.zeros(EVENTS, np.uint16)
        for number in range(self._count):
            t = np.arange(EVENTS) + round(1e6 * SPAN_S * number)
            time.sleep(max(zero_s + SPAN_S * number - time.monotonic(), 0.0))
            yield EventPacket(flat, flat, flat > 0, t, int(t[0]), int(t[-1]) + 1, self.size)


def test_what_waited_is_left_out_and_counted_until_the_work_is_at_the_present() -> None:
    camera, taken = Camera(400), [0]
    for packet in PacedSource(cast(Any, camera)):
        taken.append(packet.t_end_us)
        if len(taken) == 50:
            time.sleep(1.3)  # what comes meanwhile waits
    assert camera.losses["missed"] + EVENTS * (len(taken) - 1) == EVENTS * 400
    assert camera.losses["missed"] >= EVENTS * 0.9 / SPAN_S / 1.0 * 0.9
    assert 1.0 < np.diff(taken).max() * 1e-6 < 2.5
    assert len(taken) > 100
