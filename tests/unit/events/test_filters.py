"""Filters: equal to plain twins, and the same events however the stream is cut."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.events.filters import BackgroundActivityFilter, RandomDrop
from stand_ins.random_packets import random_packet, rows

SIZE = (12, 9)
FILTERS = {
    "activity": lambda: BackgroundActivityFilter(SIZE, window_us=40),
    "drop": lambda: RandomDrop(0.4, seed=5),
}


@pytest.mark.parametrize("name", FILTERS)
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), n=st.integers(0, 300), cuts=st.lists(st.integers(0, 300)))
def test_any_packets_give_the_same_events(name: str, seed: int, n: int, cuts: list[int]) -> None:
    whole = random_packet(seed, n, SIZE)
    edges = [0, *sorted(min(cut, n) for cut in cuts), n]
    parts = [whole.part(a, b, 0, whole.t_end_us) for a, b in itertools.pairwise(edges)]
    once, often = FILTERS[name](), FILTERS[name]()
    assert rows(*(often(part) for part in parts)) == rows(once(whole))


@pytest.mark.parametrize("seed", range(4))
def test_background_activity_equals_its_twin(seed: int) -> None:
    whole = random_packet(seed, 400, SIZE)
    seen: dict[tuple[int, int], int] = {}
    expected = []
    for t, x, y, p in rows(whole):
        near = [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        if any(t - seen[place] <= 25 for place in near if place in seen):
            expected.append((t, x, y, p))
        seen[x, y] = t
    found = BackgroundActivityFilter(SIZE, window_us=25)(whole)
    assert rows(found) == expected
    assert 0 < len(expected) < 400


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="window_us"):
        BackgroundActivityFilter(SIZE, window_us=0)
