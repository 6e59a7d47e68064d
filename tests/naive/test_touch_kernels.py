"""The kernels of touches and live forces against the same sums over whole arrays."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.field.lost_markers import repair_kernel
from spikingtac.touch.field.selection import select_kernel
from spikingtac.touch.force.creep_memory import CreepConfig, CreepMemory
from spikingtac.touch.force.rest_zero import RestZero, RestZeroConfig
from spikingtac.touch.touches.backlash import STRING_PX, Backlash
from spikingtac.touch.touches.spread import spread_kernel

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


@pytest.mark.parametrize("chain", [((0.2,), (2.0,)), ((0.3, 0.1), (0.05, 8.0))])
def test_creep_is_inverted_as_its_sums_say(
    chain: tuple[tuple[float, ...], tuple[float, ...]],
) -> None:
    fractions, times_s = (np.array(values) for values in chain)
    memory = CreepMemory(CreepConfig(fractions=chain[0], times_s=chain[1]))
    rng, retarded, last_us = np.random.default_rng(2), np.zeros((len(fractions), 6)), 0
    for t_us in np.cumsum(rng.integers(0, 40_000, 200)).tolist():
        moved = rng.normal(size=(3, 2))
        found = memory.elastic(t_us, moved)
        if last_us:
            gain = -np.expm1(-1e-6 * (t_us - last_us) / times_s)
            kept = (fractions * (1.0 - gain)) @ retarded
            elastic = (moved.ravel() - kept) / (1.0 + float(fractions @ gain))
            retarded += gain[:, None] * (elastic - retarded)
            np.testing.assert_allclose(found, elastic.reshape(3, 2), rtol=1e-12, atol=1e-14)
        last_us = t_us
    assert np.abs(retarded).max() > 0.01


def test_the_zero_follows_the_rests() -> None:
    rng = np.random.default_rng(3)
    config, radius = RestZeroConfig(average_s=0.5, prior_s=0.15), 0.5
    rest, zero, rested_s, t_us, seen = RestZero(config, radius, 8), np.zeros(8), 0.15, 0, 0
    for number in range(200):
        step_s = min(1e-6 * int(rng.integers(1_000, 150_000)), 0.1) if number else 0.1
        t_us += round(1e6 * step_s)
        frame = 0.3 + 0.1 * rng.normal(size=8) + 4.0 * (number % 3 == 2)
        away = frame - zero
        if (away * away).mean() < radius**2:
            seen += 1
            rested_s = min(rested_s + step_s, config.average_s)
            zero = zero + step_s / rested_s * away
        np.testing.assert_allclose(rest.subtract(t_us, frame), frame - zero, rtol=1e-13, atol=1e-14)
    assert 100 < seen < 150
