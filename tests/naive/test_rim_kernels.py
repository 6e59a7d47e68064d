"""Kernels of vibration and of the swing against plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.ageing.swing_runs import LONGEST_GAP_US, longest_runs_kernel
from spikingtac.touch.vibration.edge_counts import (
    PHASES,
    SPREAD,
    SPREAD_SHARE,
    edge_counts_kernel,
)
from spikingtac.touch.vibration.rim_cells import (
    NO_CELL,
    REACH_PX,
    RING_PX,
    SECTORS,
    place_rims_kernel,
)
from spikingtac.touch.vibration.rim_memory import BIN_US, count_events_kernel

SIDE = 40


def events(seed: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(10, 20, count).astype(np.uint16) for _ in range(2))
    t = np.cumsum(rng.choice([1, 300, LONGEST_GAP_US], count, p=[0.6, 0.399, 0.001]))
    return x, y, rng.random(count) < 0.7, t.astype(np.int64)


@pytest.mark.parametrize("count", [0, 1, 5_000])
def test_longest_runs(count: int) -> None:
    x, y, p, t = events(1, count)
    run, longest = np.zeros((SIDE, SIDE), np.int16), np.zeros((2, SIDE, SIDE), np.int16)
    longest_runs_kernel((x, y, p, t), run, np.zeros((SIDE, SIDE), np.int64), longest)
    told: dict[tuple[int, int], tuple[bool, int, int]] = {}
    expected = np.zeros_like(longest)
    for column, row, on, t_us in zip(x.tolist(), y.tolist(), p.tolist(), t.tolist(), strict=True):
        was_on, length, before_us = told.get((row, column), (on, 0, t_us))
        goes_on = was_on == on and t_us - before_us <= LONGEST_GAP_US
        length = length + 1 if goes_on else 1
        told[row, column] = (on, length, t_us)
        expected[int(on), row, column] = max(expected[int(on), row, column], length)
    assert (longest == expected).all()


@pytest.mark.parametrize("count", [0, 1, 5_000])
def test_counts_of_cells(count: int) -> None:
    x, y, p, t = events(2, count)
    cell = np.random.default_rng(3).integers(-1, 5, (SIDE, SIDE)).astype(np.int16)
    counts = np.zeros((7, 10), np.uint16)
    count_events_kernel(x, y, p, t, cell, counts)
    expected = np.zeros_like(counts)
    for column, row, on, t_us in zip(x.tolist(), y.tolist(), p.tolist(), t.tolist(), strict=True):
        if cell[row, column] != NO_CELL:
            expected[t_us // BIN_US % 7, 2 * cell[row, column] + on] += 1
    assert (counts == expected).all()


def test_places_of_cells() -> None:
    center = np.array([[12.3, 14.8], [27.9, 15.1], [2.0, 37.5]])
    radius = np.array([5.0, 6.2, 4.0])
    cell = np.zeros((SIDE, SIDE), np.int16)
    place_rims_kernel(center, radius, cell, np.empty((SIDE, SIDE), np.float32))
    for y in range(SIDE):
        for x in range(SIDE):
            away = np.hypot(x - center[:, 0], y - center[:, 1]) - radius
            nearest = int(np.abs(away).argmin())
            if abs(away[nearest]) >= REACH_PX:
                assert cell[y, x] == NO_CELL
                continue
            ring = int((away[nearest] + REACH_PX) / RING_PX)
            angle = np.arctan2(y - center[nearest, 1], x - center[nearest, 0])
            sector = int((angle + np.pi) / (2 * np.pi) * SECTORS) % SECTORS
            assert cell[y, x] == ring * SECTORS + sector


def settled_levels(away: np.ndarray, contrast: float, lag: float) -> list[float]:
    """A cycle of the low-pass after a hundred others, so that it has forgotten how it began."""
    light = (1.0 + (contrast - 1.0) / (1.0 + np.exp(away))) / contrast
    now, seen = 0.0, []
    for step in range(101 * PHASES):
        here = step % PHASES
        now += (np.log(light[here]) - now) * (1.0 - np.exp(-light[here] / lag))
        seen.append(float(now))
    return seen[-PHASES:]


@pytest.mark.parametrize("hz", [20.0, 498.0, 1_000.0])
@pytest.mark.parametrize("lag_us", [100.0, 272.0, 740.0])
def test_expected_events_of_an_edge(hz: float, lag_us: float) -> None:
    distance, amplitude = np.linspace(-3.0, 3.0, 5), np.array([0.0, 0.7, 2.5])
    step_us, thresholds = 1e6 / hz / PHASES, np.array([0.25, 0.2])
    pixel = (6.0, lag_us / step_us, 100.0 / step_us)
    out = np.zeros((2, len(amplitude), len(distance)))
    edge_counts_kernel(distance, amplitude, pixel, thresholds, out)
    expected = np.zeros_like(out)
    wave = np.sin(2.0 * np.pi * np.arange(PHASES) / PHASES)
    for a, k in np.ndindex(len(amplitude), len(distance)):
        seen = settled_levels(distance[k] - amplitude[a] * wave, pixel[0], pixel[1])
        for polarity, sense in ((0, -1.0), (1, 1.0)):
            own, other = thresholds[polarity], thresholds[1 - polarity]
            for spread, share in zip(SPREAD, SPREAD_SHARE, strict=True):
                rises = [sense * (b - a) for a, b in zip(seen, [*seen[1:], seen[0]], strict=True)]
                steps = sum(r / (own * spread + pixel[2] * r) for r in rises if r > 0.0)
                told = max(0.0, steps - 0.5 * (1.0 + other / own))
                expected[polarity, a, k] += share * told
    np.testing.assert_allclose(out, expected, atol=1e-9)
