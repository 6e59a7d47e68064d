"""The kernels of the graded and of the binary map against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket

SIZE = (9, 7)


def random_packet(seed: int, count: int) -> EventPacket:
    rng = np.random.default_rng(seed)
    return EventPacket(
        rng.integers(0, SIZE[0], count).astype(np.uint16),
        rng.integers(0, SIZE[1], count).astype(np.uint16),
        rng.random(count) < 0.5,
        np.sort(rng.integers(0, 1_000, count)),
        0,
        1_000,
        SIZE,
    )


def naive(
    start: np.ndarray, packet: EventPacket, on: np.ndarray, off: np.ndarray, dark: bool
) -> tuple[np.ndarray, np.ndarray]:
    memory, level = start.astype(float), start.astype(float)
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        step = on[y, x] if p != dark else -off[y, x]
        memory[y, x] = np.clip(memory[y, x] + step, 0.0, 1.0)
        level[y, x] = np.clip(memory[y, x] + step / 2.0, 0.0, 1.0)
    return memory, level


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("count", [0, 1, 40, 2_000])
def test_kernel_equals_its_twin(count: int, dark: bool) -> None:
    rng = np.random.default_rng(count)
    start = rng.random((SIZE[1], SIZE[0])).astype(np.float32)
    on = rng.uniform(0.05, 0.3, start.shape).astype(np.float32)
    off = rng.uniform(0.05, 0.3, start.shape).astype(np.float32)
    state_map = GradedStateMap(start, on, off, dark_markers=dark)
    packet = random_packet(count, count)
    state_map.absorb(packet)
    memory, level = naive(start, packet, on, off, dark)
    np.testing.assert_allclose(state_map.memory, memory, atol=1e-5)
    np.testing.assert_allclose(state_map.values, level, atol=1e-5)


def test_lost_events_enlarge_the_steps_by_the_dead_band_law() -> None:
    state_map = GradedStateMap(np.zeros((SIZE[1], SIZE[0]), np.float32), 0.2, 0.2)
    state_map.set_events_kept(0.5)  # four of five steps are events, two arrive: 1 / (2 + 1)
    one = np.array([1], np.uint16)
    state_map.absorb(EventPacket(one, one, one > 0, np.array([0]), 0, 1, SIZE))
    assert state_map.memory[1, 1] == pytest.approx(1.0 / 3.0)


def test_unfit_steps_and_sizes_are_refused() -> None:
    start = np.zeros((SIZE[1], SIZE[0]), np.float32)
    with pytest.raises(ConfigError, match="share of the full swing"):
        GradedStateMap(start, 0.0)
    with pytest.raises(ConfigError, match=r"shape \(2, 2\)"):
        GradedStateMap(start, np.ones((2, 2), np.float32))
    with pytest.raises(ConfigError, match="4x4"):
        GradedStateMap(start).absorb(EventPacket.empty(0, 1, (4, 4)))


@pytest.mark.parametrize("events", [0, 1, 2, 500])
@pytest.mark.parametrize("dark", [False, True])
def test_painting_equals_its_twin(events: int, dark: bool) -> None:
    start = (np.random.default_rng(events).random((SIZE[1], SIZE[0])) < 0.3).astype(np.float32)
    packet, expected = random_packet(events, events), start.copy()
    state_map = BinaryStateMap(SIZE, start, dark_markers=dark)
    state_map.absorb(packet)
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        expected[y, x] = float(bool(p) ^ dark)
    np.testing.assert_array_equal(state_map.values, expected)
    assert state_map.values.dtype == np.float32
