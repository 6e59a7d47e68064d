"""The kernels of touches and live forces against the same sums over whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.force.model import (
    AVERAGE_S,
    LONGEST_GAP_S,
    MEMORY_S,
    MEMORY_SHARES,
    PRIOR_S,
    FieldStream,
)
from spikingtac.touch.lost_markers import repair_kernel, select_kernel, spread_kernel
from spikingtac.touch.onset import STRING_PX, Backlash

Array = np.ndarray


def test_strings_follow_the_markers() -> None:
    rng = np.random.default_rng(1)
    path = np.cumsum(rng.normal(0.0, 0.05, (300, 7, 2)), axis=0)
    path[40:50] = path[40]  # stands still
    backlash, followed = Backlash(7), np.zeros((7, 2))
    for moved in path:
        away = moved - followed
        length = np.sqrt((away * away).sum(axis=1, keepdims=True))
        string = away * np.minimum(STRING_PX / np.maximum(length, STRING_PX), 1.0)
        followed = moved - string
        np.testing.assert_array_equal(backlash.update(moved), string)
    assert np.hypot(*backlash.string.T).max() == pytest.approx(STRING_PX)


@pytest.mark.parametrize("markers", [1, 4, 9, 64])
@pytest.mark.parametrize("share", [0.0, 0.6])
def test_spreads_are_those_of_sorted_distances(markers: int, share: float) -> None:
    away = np.random.default_rng(markers).normal(size=(markers, 2)) + 3.0
    kept = away.copy()
    middle = np.sort(away, axis=0)[markers // 2]
    distance = np.sort(np.hypot(*(away - middle).T))
    largest, spread = spread_kernel(away, share)
    assert largest == pytest.approx(np.hypot(*away.T).max(), rel=1e-14)
    assert spread == pytest.approx(distance[int(share * markers)], rel=1e-14)
    np.testing.assert_array_equal(away, kept)


@pytest.mark.parametrize("different", [1, 3, 1_000])
@pytest.mark.parametrize("count", [1, 2, 9, 40])
def test_a_rank_is_selected_as_from_sorted_values(count: int, different: int) -> None:
    values = np.random.default_rng(count).integers(0, different, count).astype(float)
    for rank in range(count):
        assert select_kernel(values.copy(), rank) == np.sort(values)[rank]


@pytest.mark.parametrize("neighbours", [1, 4, 9])
def test_lost_markers_are_repaired_by_medians(neighbours: int) -> None:
    rng = np.random.default_rng(neighbours)
    moved, near = rng.normal(size=(40, 2)), rng.integers(0, 40, (neighbours, 40))
    lost = rng.uniform(size=40) < 0.3
    expected, out = moved.copy(), moved.copy()
    expected[lost] = np.sort(moved[near[:, lost]], axis=0)[neighbours // 2]
    repair_kernel(moved, near, lost, out)
    np.testing.assert_array_equal(out, expected)
    assert (out != moved).any()


def test_fields_are_told_from_their_zero_with_their_past() -> None:
    """The zero as a mean of rests, and the memory marker by marker, in plain Python."""
    rng, radius = np.random.default_rng(3), 0.5
    stream, zero, rested_s, t_us = FieldStream(radius, 8, memory=True), np.zeros(8), PRIOR_S, 0
    means, seen, gaps = np.zeros((2, 8)), 0, 0
    for number in range(200):
        step_us = int(rng.integers(1_000, 250_000)) if number else 0
        t_us, step_s = t_us + step_us, 1e-6 * step_us
        frame = 0.3 + 0.1 * rng.normal(size=8) + 4.0 * (number % 3 == 2)
        away = frame - zero
        if (away * away).mean() < radius**2:
            seen += 1
            share_s = min(step_s, 0.1) if number else 0.1
            rested_s = min(rested_s + share_s, AVERAGE_S)
            zero = zero + share_s / rested_s * away
        found = stream.update(t_us, frame)
        fade = [1.0 - np.exp(-step_s / tau) for tau in MEMORY_S[:, 0]]
        if step_s > LONGEST_GAP_S:
            gaps += 1
            means = np.array([(1.0 - g) * row for g, row in zip(fade, means, strict=True)])
            fade = [0.0, 0.0]
        shares = MEMORY_SHARES[:, 0]
        kept = sum(c * (1.0 - g) * m for c, g, m in zip(shares, fade, means, strict=True))
        told = (frame - zero + kept) / (1.0 - sum(c * g for c, g in zip(shares, fade, strict=True)))
        means = np.array([m + g * (told - m) for g, m in zip(fade, means, strict=True)])
        np.testing.assert_allclose(found, told, rtol=1e-12, atol=1e-13)
    assert 100 < seen < 150
    assert gaps > 10
