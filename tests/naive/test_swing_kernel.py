"""The kernel of the swing against plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.ageing import LONGEST_GAP_US, longest_runs_kernel

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
