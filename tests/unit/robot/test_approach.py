"""Move until contact on the kinematic twin, with a detector that knows where the wall is."""

from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.robot.approacher import Approach, ApproachConfig, approach
from spikingtac.robot.arm import ArmState
from spikingtac.robot.prober import ProbingConfig
from spikingtac.robot.watchdog import Watchdog
from spikingtac.sim.rig.ur3 import UR3Twin
from spikingtac.types import Contact

WALL_MM = 60.0
TARGET_MM = np.array([90.0, 0.0, 0.0])
QUICK = ApproachConfig(speed_mm_s=180.0, settle_windows=20)


class Bench:
    """An arm and windows (their end times, us) whose pull lets 1 ms pass."""

    def __init__(self, seed: int = 0) -> None:
        self.arm = UR3Twin(np.zeros(3), np.random.default_rng(seed))
        self.now_us = 0

    def windows(self) -> Iterator[int]:
        for t_us in range(1000, 10_000_000, 1000):
            self.now_us = t_us
            self.arm.advance_to(t_us)
            yield t_us

    def update(self, window: int) -> Contact | None:
        self.beyond_mm = beyond = self.arm.true_position_mm()[0] - WALL_MM
        return Contact(t_us=window, count=1.0, threshold=0.0) if beyond > 0.0 else None

    def approach(self, watchdog: Watchdog | None = None) -> Approach:
        return approach(self.arm, self.windows(), self, TARGET_MM, QUICK, watchdog)


def test_it_stops_at_contact_and_reports_both_poses() -> None:
    overshoot, read = [], []
    for seed in range(40):
        bench = Bench(seed)
        found = bench.approach()
        assert found.contact is not None
        assert found.collision_mm is not None
        assert 0.0 < bench.beyond_mm <= 0.18
        stopped_mm = bench.arm.true_position_mm()[0]
        assert found.stop_mm[0] == pytest.approx(stopped_mm, abs=0.2)
        overshoot.append(stopped_mm - WALL_MM - bench.beyond_mm)
        read.append(found.collision_mm[0] - WALL_MM)
    assert np.mean(overshoot) == pytest.approx(6.2, abs=0.4)
    assert np.min(read) < -0.5


@pytest.mark.parametrize(
    ("target_mm", "speed_mm_s", "told"),
    [(TARGET_MM, 0.0, "the speed is 0.0 mm/s"), (TARGET_MM[:2], 9.0, "three finite numbers")],
)
def test_what_is_no_motion_is_refused(target_mm: np.ndarray, speed_mm_s: float, told: str) -> None:
    bench, config = Bench(), ApproachConfig(speed_mm_s=speed_mm_s)
    with pytest.raises(ConfigError, match=told):
        approach(bench.arm, bench.windows(), bench, target_mm, config)


@pytest.mark.parametrize("limit", ["travel_limit_mm", "force_limit_n"])
def test_a_limit_that_is_no_number_is_refused(limit: str) -> None:
    with pytest.raises(ConfigError, match="must be above 0"):
        ProbingConfig(**{limit: np.nan})


def test_a_trip_of_the_watchdog_ends_the_approach() -> None:
    bench = Bench()
    watchdog = Watchdog(bench.arm.stop, lambda: bench.now_us * 1e-6, stale_s=0.01)
    watchdog.self_test()
    watchdog.arm()
    with pytest.raises(DeviceError, match=r"watchdog stopped the arm: stale, no heartbeat"):
        bench.approach(watchdog)
    bench.arm.advance_to(1_000_000)
    assert bench.arm.state() is ArmState.IDLE
