"""The rota of a tracker's chores."""

from itertools import pairwise

import pytest

from spikingtac.markers.periodic_task import PeriodicTask

STEP_US = 100


def _turns_us(chore: PeriodicTask, until_us: int) -> list[int]:
    return [t for t in range(STEP_US, until_us, STEP_US) if chore.turn_s(t) is not None]


def test_without_a_period_every_estimate_is_a_turn() -> None:
    chore = PeriodicTask(0, phase=0.5)
    assert [chore.turn_s(t) for t in (5, 1_005, 3_005)] == pytest.approx([0.0, 1e-3, 2e-3])


def test_chores_of_one_period_meet_only_at_the_first_estimate() -> None:
    chores = [PeriodicTask(1_000, phase) for phase in (0.0, 1 / 4, 2 / 4, 3 / 4)]
    turns_us = [_turns_us(chore, 10_000) for chore in chores]
    assert {turns[0] for turns in turns_us} == {STEP_US}
    later = [t for turns in turns_us for t in turns[1:]]
    assert len(later) == len(set(later))
    for turns in turns_us:
        assert {after - before for before, after in pairwise(turns[1:])} == {1_000}


def test_the_time_since_the_last_turn_is_told_also_after_a_late_one() -> None:
    chore = PeriodicTask(1_000)
    assert chore.turn_s(100) == 0.0
    assert chore.turn_s(1_000) is None
    assert chore.turn_s(1_700) == pytest.approx(1.6e-3)
    assert chore.turn_s(2_600) is None
    assert chore.turn_s(2_700) == pytest.approx(1.0e-3)
