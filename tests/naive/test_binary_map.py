"""The binary map's kernels against plain Python, on random and edge packets."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.types import EventPacket

SIZE = (37, 23)


def random_packet(
    rng: np.random.Generator, events: int, t_start_us: int = 1_000, span_us: int = 9_500
) -> EventPacket:
    return EventPacket(
        x=rng.integers(0, SIZE[0], events).astype(np.uint16),
        y=rng.integers(0, SIZE[1], events).astype(np.uint16),
        p=rng.random(events) < 0.5,
        t=np.sort(rng.integers(t_start_us, t_start_us + span_us, events)).astype(np.int64),
        t_start_us=t_start_us,
        t_end_us=t_start_us + span_us,
        size=SIZE,
    )


def naive_paint(start: np.ndarray, packet: EventPacket, dark_markers: bool) -> np.ndarray:
    values = start.copy()
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        values[y, x] = float(bool(p) ^ dark_markers)
    return values


@pytest.mark.parametrize("events", [0, 1, 2, 500, 5_000])
@pytest.mark.parametrize("dark_markers", [False, True])
def test_painting_equals_the_twin(events: int, dark_markers: bool) -> None:
    rng = np.random.default_rng(events)
    start = (rng.random((SIZE[1], SIZE[0])) < 0.3).astype(np.float32)
    packet = random_packet(rng, events)
    state_map = BinaryStateMap(SIZE, start, dark_markers=dark_markers)
    state_map.absorb(packet)
    np.testing.assert_array_equal(state_map.values, naive_paint(start, packet, dark_markers))
    assert state_map.values.dtype == np.float32
