"""Regular windows: empties kept, any packets give the same windows, the end is partial."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spikingtac.events.windows import cut, windows
from spikingtac.types import EventPacket

SIZE = (4, 4)


def packet(times: list[int], start_us: int, end_us: int) -> EventPacket:
    n = len(times)
    return EventPacket(
        np.arange(n, dtype=np.uint16) % 4,
        np.zeros(n, np.uint16),
        np.ones(n, np.bool_),
        np.array(times, np.int64),
        start_us,
        end_us,
        SIZE,
    )


def spans(found: list[EventPacket]) -> list[tuple[int, int, list[int]]]:
    return [(w.t_start_us, w.t_end_us, w.t.tolist()) for w in found]


def test_empty_windows_are_kept() -> None:
    found = list(windows([packet([0, 35], 0, 36)], 10))
    assert spans(found) == [(0, 10, [0]), (10, 20, []), (20, 30, []), (30, 36, [35])]


def test_windows_may_begin_before_or_within_the_stream() -> None:
    stream = [packet([100, 105, 112], 100, 113)]
    assert spans(list(windows(stream, 10, t_start_us=85))) == [
        (85, 95, []),
        (95, 105, [100]),
        (105, 113, [105, 112]),
    ]
    assert spans(list(windows(stream, 10, t_start_us=104))) == [(104, 113, [105, 112])]


def test_finite_edges_end_the_stream() -> None:
    found = list(cut([packet([1, 5, 9], 0, 10)], iter([2, 4, 8])))
    assert spans(found) == [(2, 4, []), (4, 8, [5])]


@given(
    times=st.lists(st.integers(0, 300), max_size=40).map(sorted),
    cuts=st.lists(st.integers(0, 301), max_size=8).map(sorted),
    period_us=st.integers(1, 90),
    start_us=st.none() | st.integers(-50, 350),
)
def test_any_packets_give_the_same_windows(times, cuts, period_us, start_us) -> None:
    whole = packet(times, 0, 301)
    edges = [0, *cuts, 301]
    parts = []
    for first, last in itertools.pairwise(edges):
        a, b = np.searchsorted(whole.t, (first, last))
        parts.append(whole.part(int(a), int(b), first, last))
    found = spans(list(windows(parts, period_us, start_us)))
    assert found == spans(list(windows([whole], period_us, start_us)))
    origin = 0 if start_us is None else start_us
    expected = [t for t in times if t >= origin]
    assert [t for _, _, inside in found for t in inside] == expected
    for (_, end, _), (start, _, _) in itertools.pairwise(found):
        assert end == start
    assert all(end - start == period_us for start, end, _ in found[:-1])
