"""Wrong timestamps are flattened, restarts re-based, leaps believed and counted."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spikingtac.events.formats.packing import TimeCourse
from spikingtac.types import LossCounters

S = 1_000_000


def mended(times: list[int], chunk: int = 1 << 20) -> tuple[list[int], dict[str, int]]:
    """Return the times as a file of such chunks gives them, and what was counted."""
    losses = LossCounters()
    course = TimeCourse(losses)
    found: list[int] = []
    waiting = np.empty(0, np.int64)
    for first in range(0, len(times), chunk):
        piece = np.concatenate([waiting, np.array(times[first : first + chunk], np.int64)])
        time, count = course.mend(piece, final=False)
        found += time.tolist()
        waiting = piece[count:]
    time, count = course.mend(waiting, final=True)
    assert count == len(waiting)
    return found + time.tolist(), dict(losses)


def test_a_lone_far_time_is_flattened_wherever_the_chunks_end() -> None:
    times = [0, 10, 20, 1 << 59, 30, 40]
    for chunk in range(1, 7):
        assert mended(times, chunk) == ([0, 10, 20, 20, 30, 40], {"time_glitch": 1})


def test_a_block_of_zeros_moves_nothing_that_follows() -> None:
    times = [*range(5 * S, 5 * S + 100), *[0] * 1_000, *range(5 * S + 200, 5 * S + 300)]
    for chunk in (1 << 20, 150):
        found, losses = mended(times, chunk)
        assert found[:100] + found[1_100:] == times[:100] + times[1_100:]
        assert losses == {"time_glitch": 1_000}


def test_a_restart_goes_on_from_the_last_event() -> None:
    times = [5 * S, 5 * S + 10, 3, 4, 90]
    assert mended(times) == (
        [5 * S, 5 * S + 10, 5 * S + 10, 5 * S + 11, 5 * S + 97],
        {"time_reset": 1},
    )


def test_wrong_first_times_do_not_move_the_rest() -> None:
    times = [1 << 58, *range(100, 200)]
    assert mended(times) == ([100, *range(100, 200)], {"time_glitch": 1})


def test_slow_events_are_no_leaps() -> None:
    times = [step * 300_000 for step in range(20_000)]
    assert mended(times) == (times, {})
    fallen = [*times, times[-1] - 50]
    assert mended(fallen) == ([*times, times[-1]], {"time_backwards": 1})


def test_many_silences_are_kept() -> None:
    times = [step * 3 * S for step in range(100)]
    for chunk in (1 << 20, 10):
        assert mended(times, chunk) == (times, {"time_jump": 99})


@given(
    times=st.lists(st.integers(0, 1 << 59) | st.integers(0, 3 * S), max_size=40),
    chunk=st.integers(1, 41),
)
def test_any_times_come_out_in_order(times: list[int], chunk: int) -> None:
    found, losses = mended(times, chunk)
    assert len(found) == len(times)
    assert found == sorted(found)
    assert (times == found) or losses
    assert mended(found)[0] == found
