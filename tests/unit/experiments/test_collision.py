"""Scoring and plan of the collision experiment on made-up records; its frame camera."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac_paper.collision import approach
from spikingtac_paper.collision.approach import (
    FrameSampler,
    exposures_us,
    measured_px,
    quiet_threshold_px,
)
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
    figures = deviation, deviation - 0.1, overshoot, delay_us
    return dict(zip(("deviation_mm", "read_mm", "overshoot_mm", "delay_us"), figures, strict=True))


def record(seed: int, speed: str = "0.18", **methods: dict[str, float] | None) -> dict:
    costs = {name: {"10": 98, "50": 2} for name in methods if name == "default"}
    case = f"typical/{speed}"
    return {"case": case, "seed": seed, "methods": methods, "costs_us": costs}


def at_speed(speed: str, seed: int) -> dict:
    default, ideal = outcome(0.1 * (1 + seed), 1.0 + seed), outcome(0.0, 0.9 + seed)
    return record(seed, speed, default=default, zero_delay=ideal, frame_sampling=outcome(2.0, 4.0))


def value(rows: list[Row], method: str, case: str, metric: str) -> float | None:
    (row,) = [r for r in rows if (r.method, r.case, r.metric) == (method, case, metric)]
    return row.value


def test_all_is_the_mean_over_the_speeds_and_the_worst_of_them() -> None:
    seeds = {speed: range(1 if speed == "0.01" else 3) for speed in SPEEDS}
    records = [at_speed(speed, seed) for speed, some in seeds.items() for seed in some]
    rows = collision_rows(records, [])
    expected = (0.1 + 9 * 0.2) / 10  # one approach at the first speed, three at the others
    assert value(rows, "default", "typical/all", "deviation_mean_mm") == pytest.approx(expected)
    assert value(rows, "default", "typical/all", "deviation_max_mm") == pytest.approx(0.3)
    assert value(rows, "default", "typical/0.18", "overshoot_max_mm") == 3.0
    assert value(rows, "default", "typical/all", "decision_p99_us") == 50.0
    assert value(rows, "default", "all", "deviation_mean_mm") == pytest.approx(expected)
    assert {row.metric for row in rows} <= set(METRICS)


def test_misses_and_premature_stops_are_counted_and_left_out_of_the_means() -> None:
    found = outcome(0.2, 1.0), None, outcome(-3.0, -2.0, delay_us=-5_000.0)
    rows = collision_rows([record(seed, default=one) for seed, one in enumerate(found)], [])
    assert value(rows, "default", "typical/0.18", "missed") == 1.0
    assert value(rows, "default", "typical/0.18", "premature") == 1.0
    assert value(rows, "default", "typical/0.18", "deviation_mean_mm") == pytest.approx(0.2)
    nothing = collision_rows([record(0, default=None)], [])
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
    for one, other in zip(plan(QUICK, BASE), plan(RunSize(), BASE), strict=True):
        assert {job.case for job in one} == {job.case for job in other}


def test_only_detectors_that_find_every_slow_approach_soon_take_part_in_the_series() -> None:
    records = [record(k, "0.0008", default=outcome(0.1, 1.0), event_count=None) for k in (1, 0)]
    for one in records:
        one["costs_us"] = {"default": {}, "event_count": {}}
    assert fast_detectors(records) == ("default",)
    assert fast_detectors([]) == ()


REST = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 37.0


def moving(speed_px_s: float, length_us: int) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0, length_us + 1, 1000).astype(float)
    shift = speed_px_s * times * 1e-6
    return times, REST + np.stack([shift, 0 * shift], axis=-1)[:, None, :]


def test_exposures_are_regular_half_open_and_keep_their_phase() -> None:
    times = exposures_us(0.25, 0, 1_000_000)
    assert len(times) == 32
    assert times[0] == pytest.approx(0.25 * 31_250.0)
    assert np.diff(times) == pytest.approx(np.full(31, 31_250.0))
    parts = [exposures_us(0.25, k * 7_000, (k + 1) * 7_000) for k in range(100)]
    assert np.concatenate(parts) == pytest.approx(exposures_us(0.25, 0, 700_000))


def test_frames_see_the_truth_at_their_exposure_with_the_declared_noise() -> None:
    times = np.full(200, 10_500.0)
    off_px = measured_px(times, moving(100.0, 50_000), np.random.default_rng(0)) - REST
    assert off_px.mean(axis=(0, 1)) == pytest.approx([1.05, 0.0], abs=0.01)
    assert off_px.std(axis=0).mean() == pytest.approx(approach.NOISE_PX, rel=0.02)


def test_the_threshold_bounds_the_quiet_interval_and_keeps_the_budget() -> None:
    sums = np.random.default_rng(1).normal(8.0, 0.5, 2_000)
    threshold = quiet_threshold_px(sums)
    assert threshold >= sums.max()
    assert threshold == pytest.approx(8.0 + 4.29 * 0.5, rel=0.01)
    outlier = np.append(sums, 30.0)
    assert quiet_threshold_px(outlier) == 30.0
    with pytest.raises(ValueError, match="at least 50"):
        quiet_threshold_px(sums[:10])


def test_contact_is_seen_in_the_first_frame_beyond_the_threshold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(approach, "NOISE_PX", 0.0)
    sampler = FrameSampler(64.0, 0.5, np.random.default_rng(0))
    sampler.start(REST)
    times, centers = moving(20.0, 200_000)  # 1 px per marker at 50 ms; frames at 46.9, 78.1 ms
    assert sampler.look((times[:60], centers[:60])) is None
    assert sampler.look((times[59:], centers[59:])) == pytest.approx(2.5 * 31_250.0)
