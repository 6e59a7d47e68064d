"""Windows, health and times of a stream: whatever its packing, they are the same."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spikingtac.errors import ConfigError
from spikingtac.events.formats.codec import KINDS
from spikingtac.events.formats.packing import TimeCourse
from spikingtac.events.source import HARMLESS, SLOT_US, HealthMeter, slot_rate_ev_s, source_health
from spikingtac.events.windows import SILENCE_LIMIT_US, stretches, windows
from spikingtac.types import EventPacket, LossCounters
from stand_ins.random_packets import cut_at, packet_at

SIZE = (4, 4)


def packet(times_us: Any, start_us: int, end_us: int) -> EventPacket:
    return packet_at(times_us, (start_us, end_us), SIZE)


def spans(found: list[EventPacket]) -> list[tuple[int, int, list[int]]]:
    return [(w.t_start_us, w.t_end_us, w.t.tolist()) for w in found]


def test_a_leap_of_18_000_years_takes_a_minute_of_windows() -> None:
    far = 1 << 59
    found = list(windows([packet([0, 10, far], 0, far + 1)], 1_000))
    assert len(found) == SILENCE_LIMIT_US // 1_000 + 2
    assert found[-1].t.tolist() == [far]
    assert found[-1].t_start_us % 1_000 == 0


def test_stretches_end_where_the_silence_is_too_long() -> None:
    parts = [packet([0, 5], 0, 40), packet([], 40, 90), packet([90, 200], 90, 201)]
    assert [spans(list(stretch)) for stretch in stretches(parts, 30)] == [
        [(0, 35, [0, 5])],
        [(90, 120, [90])],
        [(200, 201, [200])],
    ]


def test_packets_that_leave_the_sensor_are_refused_on_entry() -> None:
    fit = packet([1], 0, 2)
    outside = EventPacket(fit.x + np.uint16(4), fit.y, fit.p, fit.t, 0, 2, SIZE)
    with pytest.raises(ConfigError, match="x from 4 to 4 px lie outside of the 4x4"):
        list(windows([outside], 10))
    for bad in (-1, np.nan, 65_536):
        column = np.array([bad])
        for x, y in ((column, fit.y), (fit.x, column)):
            with pytest.raises(ConfigError, match=r"column [xy] is \w+64 from .*give uint16"):
                EventPacket(x, y, fit.p, fit.t, 0, 2, SIZE).sound()
    unequal = EventPacket(fit.x[:0], fit.y, fit.p, fit.t, 0, 2, SIZE)
    with pytest.raises(ConfigError, match="equal length, not 0, 1, 1, 1"):
        list(windows([unequal], 10))
    for p, t, why in (
        ([-1, 1], [0, 1], "column p is int64 from -1 to 1; give bool"),
        ([0, 1], [1, 0], "from 1 to 0 us; they fall"),
        ([0, 1], [0, 2], r"from 0 to 2 us; they must lie in \[0, 2\)"),
        ([0, 1], [-1, 0], r"from -1 to 0 us; they must lie in \[0, 2\)"),
    ):
        with pytest.raises(ConfigError, match=why):
            EventPacket(fit.x.repeat(2), fit.y.repeat(2), p, t, 0, 2, SIZE).sound()


def test_lists_and_integers_of_other_types_become_the_columns_types() -> None:
    """Kernels took a polarity of -1 for brighter, and ended on lists and foreign byte orders."""
    given = EventPacket(
        [0, 3], np.array([1, 2], ">u2"), np.array([0, 1], np.uint8), np.array([0, 1], ">i8"),
        0, 2, SIZE,
    ).sound()  # fmt: skip
    plain = [(c.dtype.str, c.tolist()) for c in (given.x, given.y, given.p, given.t)]
    assert plain == [("<u2", [0, 3]), ("<u2", [1, 2]), ("|b1", [False, True]), ("<i8", [0, 1])]


@given(
    times=st.lists(st.integers(0, 300), max_size=40).map(sorted),
    cuts=st.lists(st.integers(0, 301), max_size=8).map(sorted),
    period_us=st.integers(1, 90),
    start_us=st.none() | st.integers(-50, 350),
    limit_us=st.none() | st.integers(1, 120),
)
def test_any_packets_give_the_same_windows(times, cuts, period_us, start_us, limit_us) -> None:
    whole = packet(times, 0, 301)
    parts = cut_at(whole, [0, *cuts, 301])
    found = spans(list(windows(parts, period_us, start_us, limit_us)))
    assert found == spans(list(windows([whole], period_us, start_us, limit_us)))
    origin = start_us or 0
    assert [t for _, _, inside in found for t in inside] == [t for t in times if t >= origin]
    for (start, end, _), (following, _, _) in itertools.pairwise(found):
        assert (start - origin) % period_us == 0
        assert following == end if limit_us is None else following >= end
    assert limit_us or all(end - start == period_us for start, end, _ in found[:-1])


def counted_rate(t: np.ndarray, at_us: int, first_us: int) -> float:
    """The definition, one event at a time."""
    until_us = at_us - at_us % SLOT_US
    from_us = max(until_us - SLOT_US, first_us)
    inside = sum(1 for time_us in t.tolist() if from_us <= time_us < until_us)
    return inside / ((until_us - from_us) * 1e-6) if until_us > from_us else 0.0


@pytest.mark.parametrize("step_us", [1_000, 2_857, 33_333, 100_000, 250_000])
def test_the_rate_is_that_of_the_latest_full_slot_whatever_the_packing(step_us: int) -> None:
    t = np.sort(np.random.default_rng(step_us).integers(30_000, 900_000, 2_000))
    meter = HealthMeter({})
    for start_us in range(30_000, 900_000, step_us):
        end_us = start_us + step_us
        meter.absorb(packet(t[(t >= start_us) & (t < end_us)], start_us, end_us))
        expected = counted_rate(t, end_us, 30_000)
        assert meter.now().rate_ev_s == pytest.approx(expected)
        direct = slot_rate_ev_s(
            end_us, 30_000, lambda first, last: int(np.count_nonzero((t >= first) & (t < last)))
        )
        assert direct == pytest.approx(expected)
    whole = HealthMeter({})
    whole.absorb(packet(t, 30_000, 900_000))
    assert whole.total().rate_ev_s == pytest.approx(2_000 / 0.87)


def test_every_kind_of_loss_is_in_one_counter_and_what_loses_nothing_in_none() -> None:
    for kind in KINDS:
        found = source_health({kind: 3})
        lost = found.gaps + found.overflows + found.damaged + found.reconnects
        assert lost == (0 if kind in HARMLESS else 3), kind
    told = source_health(
        {"gap": 1, "disconnected": 2, "overflow": 4, "reconnected": 5, "garbage": 6}
    )
    assert (told.gaps, told.overflows, told.reconnects, told.damaged) == (3, 4, 5, 6)


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


ZEROS = [*range(5 * S, 5 * S + 100), *[5 * S + 99] * 1_000, *range(5 * S + 200, 5 * S + 300)]
SLOW = [step * 300_000 for step in range(20_000)]
SILENT = [step * 3 * S for step in range(100)]
# Name -> times, what becomes of them, what is counted, and the chunks that they come in.
COURSES = {
    "lone": ([0, 10, 1 << 59, 30], [0, 10, 10, 30], {"time_glitch": 1}, range(1, 5)),
    "zeros": ([*ZEROS[:100], *[0] * 1_000, *ZEROS[1_100:]], ZEROS, {"time_glitch": 1_000}, [150]),
    "restart": ([5 * S, 3, 4, 90], [5 * S, 5 * S, 5 * S + 1, 5 * S + 87], {"time_reset": 1}, [9]),
    "first": ([1 << 58, *range(100, 200)], [100, *range(100, 200)], {"time_glitch": 1}, [999]),
    "slow": (SLOW, SLOW, {}, [1 << 20]),
    "held": ([*SLOW, SLOW[-1] - 50], [*SLOW, SLOW[-1]], {"time_backwards": 1}, [1 << 20]),
    "silences": (SILENT, SILENT, {"time_jump": 99}, [10, 1 << 20]),
}


@pytest.mark.parametrize("name", COURSES)
def test_time_goes_on_after_whatever_breaks_its_course(name: str) -> None:
    times, expected, losses, chunks = COURSES[name]
    for chunk in chunks:
        assert mended(times, chunk) == (expected, losses)


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
