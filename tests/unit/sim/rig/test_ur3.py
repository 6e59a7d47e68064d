"""The UR3 twin: braking distances of twin.md (section 0), staleness, lag, faults."""

import sys

import numpy as np
import pytest

from spikingtac.errors import MissingExtraError
from spikingtac.sim.rig.ur3 import UR3Config, UR3Twin

FAST_MM_S = 180.0


def approaching(rng: np.random.Generator, config: UR3Config | None = None) -> UR3Twin:
    """Return an arm that cruises at 0.18 m/s along x, at a random phase of its cycle."""
    arm = UR3Twin(config or UR3Config(), np.zeros(3), rng)
    arm.move_linear(np.array([300.0, 0.0, 0.0]), FAST_MM_S)
    arm.advance_to(int(rng.integers(600_000, 700_000)))
    return arm


def overshoots_mm(config: UR3Config, trials: int = 800) -> np.ndarray:
    rng = np.random.default_rng(1)
    found = np.empty(trials)
    for k in range(trials):
        arm = approaching(rng, config)
        touched_mm = arm.true_position_mm()[0]
        arm.stop()
        arm.advance_to(1_500_000)
        found[k] = arm.true_position_mm()[0] - touched_mm
    return found


@pytest.mark.parametrize(
    ("changes", "mean_mm", "worst_mm"),
    [
        ({}, 6.2, 7.6),
        ({"jerk_mm_s3": np.inf}, 4.7, 6.2),
        ({"cycle_s": 0.002, "jerk_mm_s3": np.inf}, 4.2, 5.1),
    ],
)
def test_overshoot_of_a_perfect_sensor(
    changes: dict[str, float], mean_mm: float, worst_mm: float
) -> None:
    found = overshoots_mm(UR3Config(**changes))
    assert found.mean() == pytest.approx(mean_mm, abs=0.1)
    assert found.max() == pytest.approx(worst_mm, abs=0.15)
    assert found.max() <= worst_mm + 0.05


def test_the_reported_pose_is_up_to_one_cycle_old() -> None:
    rng = np.random.default_rng(2)
    config = UR3Config(repeatability_mm=0.0)
    lag = np.array(
        [
            arm.pose().position_mm[0] - arm.true_position_mm()[0]
            for arm in (approaching(rng, config) for _ in range(400))
        ]
    )
    assert lag.mean() == pytest.approx(-0.72, abs=0.05)
    assert lag.min() >= -1.44 - 1e-6
    assert lag.max() <= 1e-9


def test_a_machine_without_ruckig_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(MissingExtraError, match=r"spikingtac\[arm\]"):
        UR3Twin(UR3Config(), np.zeros(3), np.random.default_rng(0)).move_linear(np.ones(3), 50.0)
