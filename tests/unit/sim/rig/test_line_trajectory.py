"""Motions along a line keep their limits, and say what is missing where there is no ruckig."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.sim.rig.ur3 import plan_move, plan_stop

SPEED, ACCELERATION, JERK = 50.0, 800.0, 40_000.0
START_MM, TARGET_MM = np.zeros(3), np.array([30.0, 40.0, 0.0])


def test_a_motion_arrives_and_keeps_its_limits() -> None:
    moving = plan_move(2.0, START_MM, TARGET_MM, (SPEED, ACCELERATION, JERK))
    np.testing.assert_allclose(moving.position_mm(moving.end_s + 1.0), TARGET_MM, atol=1e-9)
    times_s = np.linspace(2.0, moving.end_s, 2_000)
    along = np.array([moving.along(t_s)[0] for t_s in times_s])
    speeds = np.gradient(along, times_s)
    assert speeds.max() == pytest.approx(SPEED, rel=1e-3)
    assert np.abs(np.gradient(speeds, times_s)).max() < 1.01 * ACCELERATION


def test_a_stop_ends_within_the_way_that_physics_needs() -> None:
    moving = plan_move(0.0, START_MM, TARGET_MM, (SPEED, ACCELERATION, JERK))
    stop = plan_stop(0.5, moving, ACCELERATION, JERK)
    assert moving.along(0.5)[1] == pytest.approx(SPEED)
    way_mm = stop.along(stop.end_s)[0] - moving.along(0.5)[0]
    least_mm = SPEED**2 / (2 * ACCELERATION)
    assert least_mm < way_mm < least_mm + SPEED * ACCELERATION / JERK
    assert stop.along(stop.end_s)[1] == pytest.approx(0.0, abs=1e-9)


def test_a_machine_without_ruckig_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[arm\]"):
        plan_move(0.0, START_MM, TARGET_MM, (SPEED, ACCELERATION, JERK))
