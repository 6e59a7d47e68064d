"""Motions along a line keep their limits, and say what is missing where there is no ruckig."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.sim.rig.ur3 import plan_move

SPEED, ACCELERATION, JERK = 50.0, 800.0, 40_000.0
START_MM, TARGET_MM = np.zeros(3), np.array([30.0, 40.0, 0.0])


def test_a_machine_without_ruckig_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[arm\]"):
        plan_move(0.0, START_MM, TARGET_MM, (SPEED, ACCELERATION, JERK))
