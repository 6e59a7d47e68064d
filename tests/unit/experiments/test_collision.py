"""Scoring and plan of the collision experiment on made-up records."""

from pathlib import Path

import pytest

from spikingtac_paper.collision.experiment import (
    QUICK,
    QUIET_SEED,
    STRETCH_STEPS,
    CollisionJob,
    RunSize,
    fast_detectors,
    plan,
    series,
)
from spikingtac_paper.collision.scene import CollisionScene
from spikingtac_paper.collision.scoring import METRICS, SPEEDS, collision_rows
from spikingtac_paper.harness.report import Row

BASE = CollisionJob(folder=Path(), scene=CollisionScene())


def outcome(deviation: float, overshoot: float, delay_us: float = 1_000.0) -> dict[str, float]:
    return {
        "deviation_mm": deviation,
        "read_mm": deviation - 0.1,
        "overshoot_mm": overshoot,
        "delay_us": delay_us,
    }


def record(case: str, seed: int, methods: dict) -> dict:
    return {
        "case": case,
        "seed": seed,
        "methods": methods,
        "costs_us": {name: {"10": 98, "50": 2} for name in methods if name == "default"},
    }


def every_speed() -> list[dict]:
    return [
        record(
            f"typical/{speed}",
            seed,
            {
                "default": outcome(0.1 * (1 + seed), 1.0 + seed),
                "zero_delay": outcome(0.0, 0.9 + seed),
                "frame_sampling": outcome(2.0, 4.0),
            },
        )
        for speed in SPEEDS
        for seed in range(1 if speed == "0.01" else 3)
    ]


def value(rows: list[Row], method: str, case: str, metric: str) -> float | None:
    (row,) = [r for r in rows if (r.method, r.case, r.metric) == (method, case, metric)]
    return row.value


def test_all_is_the_mean_over_the_speeds_and_the_worst_of_them() -> None:
    rows = collision_rows(every_speed(), [])
    expected = (0.1 + 9 * 0.2) / 10  # one approach at the first speed, three at the others
    assert value(rows, "default", "typical/all", "deviation_mean_mm") == pytest.approx(expected)
    assert value(rows, "default", "typical/all", "deviation_max_mm") == pytest.approx(0.3)
    assert value(rows, "default", "typical/0.18", "overshoot_max_mm") == 3.0
    assert value(rows, "default", "typical/all", "decision_p99_us") == 50.0
    assert value(rows, "default", "all", "deviation_mean_mm") == pytest.approx(expected)
    assert {row.metric for row in rows} <= set(METRICS)


def test_misses_and_premature_stops_are_counted_and_left_out_of_the_means() -> None:
    records = [
        record("typical/0.18", 0, {"default": outcome(0.2, 1.0)}),
        record("typical/0.18", 1, {"default": None}),
        record("typical/0.18", 2, {"default": outcome(-3.0, -2.0, delay_us=-5_000.0)}),
    ]
    rows = collision_rows(records, [])
    assert value(rows, "default", "typical/0.18", "missed") == 1.0
    assert value(rows, "default", "typical/0.18", "premature") == 1.0
    assert value(rows, "default", "typical/0.18", "deviation_mean_mm") == pytest.approx(0.2)
    nothing = collision_rows([record("typical/0.18", 0, {"default": None})], [])
    assert value(nothing, "default", "typical/0.18", "deviation_mean_mm") is None


def test_false_stops_carry_the_exact_poisson_interval() -> None:
    stretches = [
        {"case": "typical/all", "stops": {"default": n, "frames": 0}, "seconds": 3_600.0}
        for n in (2, 1)
    ]
    rows = collision_rows([], stretches)
    assert value(rows, "default", "typical/all", "false_stops_per_hour") == 1.5
    assert value(rows, "default", "typical/all", "hours") == 2.0
    upper = value(rows, "default", "typical/all", "false_stops_upper95_per_hour")
    assert upper == pytest.approx(8.767 / 2.0, rel=1e-3)
    assert value(rows, "frame_sampling", "typical/all", "false_stops_per_hour") == 0.0


def test_no_seed_of_an_approach_calibrates_or_counts_false_stops() -> None:
    approaches, stretches = plan(RunSize(), BASE)
    later = series(RunSize(), BASE)
    used, quiet = {job.seed for job in (*approaches, *later)}, {job.seed for job in stretches}
    assert used == set(range(1_000))
    assert not used & quiet
    assert max(quiet) < QUIET_SEED
    slow = [job for job in approaches if job.case == "typical/0.0008"]
    assert len(slow) + len(later) == 1_000
    assert sum(job.case == "typical/0.18" for job in approaches) >= 200
    assert sum(job.case == "noisy/all" for job in stretches) * STRETCH_STEPS / 3.6e6 >= 10.0


def test_a_quick_run_keeps_every_case() -> None:
    full = plan(RunSize(), BASE)
    quick = plan(QUICK, BASE)
    for one, other in zip(quick, full, strict=True):
        assert {job.case for job in one} == {job.case for job in other}


def test_only_detectors_that_find_every_slow_approach_soon_take_part_in_the_series() -> None:
    late = record("typical/0.0008", 1, {"default": outcome(0.1, 1.0), "event_count": None})
    soon = record("typical/0.0008", 0, {"default": outcome(0.1, 1.0), "event_count": None})
    for one in (late, soon):
        one["costs_us"] = {"default": {}, "event_count": {}}
    assert fast_detectors([late, soon]) == ("default",)
    assert fast_detectors([]) == ()
