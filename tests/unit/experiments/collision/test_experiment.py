"""Scoring, plan and findings of the collision experiment on made-up records."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac_paper.collision.experiment import fast_detectors
from spikingtac_paper.collision.findings import findings
from spikingtac_paper.collision.methods import collision_methods
from spikingtac_paper.collision.plan import (
    QUIET_SEED,
    SPEEDS,
    STRETCH_SEED,
    CollisionConfig,
    plan,
    series,
)
from spikingtac_paper.collision.scene import CollisionScene, run_up_mm, travel_time_s
from spikingtac_paper.collision.scoring import DEFINITIONS, collision_rows, garwood
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import select_methods


def outcome(deviation: float, overshoot: float, delay_us: float = 1_000.0) -> dict[str, float]:
    return {
        "deviation_mm": deviation,
        "read_mm": deviation - 0.1,
        "overshoot_mm": overshoot,
        "delay_us": delay_us,
    }


def record(case: str, seed: int, methods: dict) -> dict:
    return {
        "group": "paired",
        "case": case,
        "seed": seed,
        "methods": methods,
        "costs_us": {name: {"10": 98, "50": 2} for name in methods if name == "default"},
        "touch_us": 1e6,
        "first_us": 0,
        "counts": [],
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
    assert {row.metric for row in rows} <= set(DEFINITIONS)


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


@pytest.mark.parametrize(
    ("events", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)]
)
def test_garwood(events: int, low: float, high: float) -> None:
    assert garwood(events, 1.0) == pytest.approx((low, high), rel=1e-3)
    assert garwood(events, 10.0) == pytest.approx((low / 10, high / 10), rel=1e-3)


def test_garwood_covers_at_least_what_it_states() -> None:
    counts = np.random.default_rng(0).poisson(3.0, 4_000)
    covered = [low <= 3.0 <= high for low, high in (garwood(int(n), 1.0) for n in counts)]
    assert np.mean(covered) > 0.945


def test_no_seed_of_an_approach_calibrates_or_counts_false_stops() -> None:
    config = CollisionConfig()
    whole, later = plan(config), series(config)
    approaches = {one.seed for one in (*whole.approaches, *later.approaches)}
    stretches = {one.seed for one in whole.stretches}
    assert approaches == set(range(1_000))
    assert not approaches & stretches
    assert min(stretches) >= STRETCH_SEED
    assert max(stretches) < QUIET_SEED
    slow = [one for one in whole.approaches if one.case == "typical/0.0008"]
    assert len(slow) + len(later.approaches) == 1_000
    assert sum(one.case == "typical/0.18" for one in whole.approaches) >= 200
    hours = sum(one.steps for one in whole.stretches if one.case == "noisy/all") / 3.6e6
    assert hours >= 10.0


def test_a_quick_run_keeps_every_case() -> None:
    full, quick = plan(CollisionConfig()), plan(CollisionConfig.quick())
    assert {one.case for one in quick.approaches} == {one.case for one in full.approaches}
    assert {one.case for one in quick.stretches} == {one.case for one in full.stretches}


def test_the_start_leaves_time_to_ring_down_and_a_second_since_the_release() -> None:
    scene = CollisionScene()
    for speed in (0.8, 10.0, 180.0):
        way = run_up_mm(scene, speed)
        assert 0.5 < way < 50.0
        assert travel_time_s(scene, speed, way) < 0.9


def test_scenes_differ_in_their_digest() -> None:
    scenes = [CollisionScene(), CollisionScene(preset="noisy"), CollisionScene(serial=2)]
    scenes += [replace(scenes[0], contrast=4.0), replace(scenes[0], past="fresh")]
    assert len({scene.digest() for scene in scenes}) == len(scenes)


def test_detectors_that_need_long_at_slow_speed_are_left_out_of_the_series() -> None:
    def slow(seed: int, one: float | None, two: float | None) -> dict:
        methods = {n: None if d is None else outcome(d, d) for n, d in (("a", one), ("b", two))}
        return {**record("typical/0.0008", seed, methods), "costs_us": {"a": {}, "b": {}}}

    assert fast_detectors([slow(0, 0.1, 0.1), slow(1, 0.2, 2.0)]) == ("a",)
    assert fast_detectors([slow(0, None, 0.3)]) == ("b",)
    assert fast_detectors([]) == ()


def test_findings_say_which_ratio_contains_the_papers_latency() -> None:
    rows = collision_rows(every_speed(), [])
    said = " ".join(findings(rows))
    assert "sensor alone explains" in said
    assert "frame_sampling over default: 2.00 (mean), 1.33 (worst)" in said
    assert "135 ms" in said
    assert "Not a safety function" in said
    assert "excess" not in said


def test_methods_are_the_registered_detectors_and_the_baselines() -> None:
    names = set(collision_methods())
    assert {"event_count", "default", "frame_sampling", "frame_plus_one", "frame_paper",
            "zero_delay"} <= names  # fmt: skip
    assert select_methods(collision_methods(), ("zero_delay", "default")) == [
        "default",
        "zero_delay",
    ]
    with pytest.raises(ConfigError, match="did you mean 'default'"):
        select_methods(collision_methods(), ("defualt",))
