"""The state maps' kernels against plain loops over the events."""

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket
from stand_ins.random_packets import random_packet, rows

SIZE = (9, 7)
SHAPE = (SIZE[1], SIZE[0])


def maps(seed: int) -> tuple[np.ndarray, ...]:
    """Return levels to begin with, and the steps of ON and of OFF events."""
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform(0.05, 0.4, SHAPE).astype(np.float32) for _ in range(3))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2_000])
def test_the_binary_and_the_graded_map_equal_their_twins(count: int, dark: bool) -> None:
    start, on, off = maps(count)
    packet = random_packet(count, count, SIZE)
    painted, memory, level = (start.astype(float) for _ in range(3))
    for _, x, y, p in rows(packet):
        painted[y, x] = float(p ^ dark)
        step = on[y, x] if p != dark else -off[y, x]
        memory[y, x] = np.clip(memory[y, x] + step, 0.0, 1.0)
        level[y, x] = np.clip(memory[y, x] + step / 2.0, 0.0, 1.0)
    binary = BinaryStateMap(SIZE, start, dark_markers=dark)
    graded = GradedStateMap(start, on, off, dark_markers=dark)
    for state_map in (binary, graded):
        state_map.absorb(packet)
    np.testing.assert_array_equal(binary.values, painted.astype(np.float32))
    np.testing.assert_allclose(graded.pixels["level"], memory, atol=1e-5)
    np.testing.assert_allclose(graded.values, level, atol=1e-5)


@pytest.mark.parametrize("dark", [False, True])
def test_levels_of_the_last_events_equal_their_twin_however_they_are_cut(dark: bool) -> None:
    start, on, off = maps(1)
    state_map = GradedStateMap(start, on, off, dark_markers=dark, lead_steps=0.0)
    packet = random_packet(2, 600, SIZE)
    memory = start + 0.5 * (off.astype(float) - on)
    for _, x, y, p in rows(packet):
        step = on[y, x] if p != dark else -off[y, x]
        memory[y, x] = min(max(memory[y, x] + step, 0.5 * off[y, x]), 1.0 - 0.5 * on[y, x])
    for first, last in ((0, 1), (1, 1), (1, 333), (333, 600)):
        state_map.absorb(packet.part(first, last, packet.t_start_us, packet.t_end_us))
    np.testing.assert_allclose(state_map.pixels["level"], memory, atol=1e-5)
    assert (state_map.values == state_map.pixels["level"])[packet.y, packet.x].all()
    state_map.reset()
    np.testing.assert_array_equal(state_map.values, start)


def test_lost_events_enlarge_the_steps_by_the_dead_band_law() -> None:
    state_map = GradedStateMap(np.zeros(SHAPE, np.float32), 0.2, 0.2)
    state_map.arrival_ratio = 0.5  # four of five steps are events, two arrive: 1 / (2 + 1)
    one = np.array([1], np.uint16)
    state_map.absorb(EventPacket(one, one, one > 0, np.array([0]), 0, 1, SIZE))
    assert state_map.pixels["level"][1, 1] == pytest.approx(1.0 / 3.0)


def test_unfit_steps_and_sizes_are_refused() -> None:
    start = np.zeros(SHAPE, np.float32)
    with pytest.raises(ConfigError, match="share of the full swing"):
        GradedStateMap(start, 0.0)
    with pytest.raises(ConfigError, match=r"shape \(2, 2\)"):
        GradedStateMap(start, np.ones((2, 2), np.float32))
    with pytest.raises(ConfigError, match="4x4"):
        GradedStateMap(start).absorb(EventPacket.empty(0, 1, (4, 4)))
