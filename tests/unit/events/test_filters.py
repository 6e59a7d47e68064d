"""Filters: equal to plain twins, and the same events however the stream is cut."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikingtac.events.filters import BackgroundActivityFilter, RandomDrop
from spikingtac.types import EventPacket

SIZE = (12, 9)
FILTERS = {
    "activity": lambda: BackgroundActivityFilter(SIZE, window_us=40),
    "drop": lambda: RandomDrop(0.4, seed=5),
}


def events(seed: int, n: int) -> EventPacket:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.integers(0, 9, n))
    x, y = rng.integers(0, SIZE[0], n), rng.integers(0, SIZE[1], n)
    end = int(t[-1]) + 1 if n else 1
    p = rng.random(n) < 0.5
    return EventPacket(
        x.astype(np.uint16), y.astype(np.uint16), p, t.astype(np.int64), 0, end, SIZE
    )


def as_tuples(packets: list[EventPacket]) -> list[tuple[int, int, int, bool]]:
    return [
        row
        for item in packets
        for row in zip(
            item.t.tolist(), item.x.tolist(), item.y.tolist(), item.p.tolist(), strict=True
        )
    ]


@pytest.mark.parametrize("name", FILTERS)
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), n=st.integers(0, 300), cuts=st.lists(st.integers(0, 300)))
def test_any_packets_give_the_same_events(name: str, seed: int, n: int, cuts: list[int]) -> None:
    whole = events(seed, n)
    edges = [0, *sorted(min(cut, n) for cut in cuts), n]
    parts = [whole.part(a, b, 0, whole.t_end_us) for a, b in itertools.pairwise(edges)]
    once, often = FILTERS[name](), FILTERS[name]()
    assert as_tuples([often(part) for part in parts]) == as_tuples([once(whole)])


@pytest.mark.parametrize("seed", range(4))
def test_background_activity_equals_its_twin(seed: int) -> None:
    whole = events(seed, 400)
    seen: dict[tuple[int, int], int] = {}
    expected = []
    for t, x, y, p in as_tuples([whole]):
        near = [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        if any(t - seen[place] <= 25 for place in near if place in seen):
            expected.append((t, x, y, p))
        seen[x, y] = t
    found = BackgroundActivityFilter(SIZE, window_us=25)(whole)
    assert as_tuples([found]) == expected
    assert 0 < len(expected) < 400


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="window_us"):
        BackgroundActivityFilter(SIZE, window_us=0)
