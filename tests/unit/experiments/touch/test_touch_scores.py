"""The scores and baselines of the experiment on what is felt, on cases that are plain."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.force.series import WrenchSeries
from spikingtac_paper.harness.report import lines_of, rows_of
from spikingtac_paper.touch.baselines import MeanDisplacement, event_touches
from spikingtac_paper.touch.experiment import METRICS
from spikingtac_paper.touch.recorded_forces import force_records
from spikingtac_paper.touch.twin_touches import touch_scores

TRUTH = [(1_000_000, 2_000_000), (3_000_000, 4_000_000)]


def test_touches_in_time_are_right() -> None:
    found = [(1_005_000, 2_050_000), (2_991_000, 3_950_000)]
    assert touch_scores(TRUTH, found) == {
        "missed": 0.0, "extra": 0.0, "begin_in_time": 1.0, "end_in_time": 1.0
    }  # fmt: skip


def test_split_missed_and_late_touches_are_told() -> None:
    found = [(1_020_000, 1_400_000), (1_500_000, 2_200_000), (5_000_000, 6_000_000)]
    assert touch_scores(TRUTH, found) == {
        "missed": 1.0, "extra": 2.0, "begin_in_time": 0.0, "end_in_time": 0.0
    }  # fmt: skip


def test_a_found_touch_that_spans_two_true_ones_is_one_of_them() -> None:
    merged = [(1_000_000, 4_100_000)]
    scores = touch_scores(TRUTH, merged)
    assert (scores["missed"], scores["extra"]) == (1.0, 0.0)
    scores = touch_scores(TRUTH, [*merged, (5_000_000, 6_000_000)])
    assert (scores["missed"], scores["extra"]) == (1.0, 1.0), "one is invented all the same"


def test_as_many_touches_as_can_be_are_found() -> None:
    found = [(1_100_000, 3_100_000), (3_200_000, 3_400_000)]
    scores = touch_scores(TRUTH, found)
    assert (scores["missed"], scores["extra"]) == (0.0, 0.0)
    longer = [(1_900_000, 4_000_000), (3_200_000, 3_300_000)]
    assert touch_scores(TRUTH, longer)["missed"] == 0.0, "though it overlaps the second by more"


def test_nothing_found_and_nothing_true_have_no_times() -> None:
    assert touch_scores(TRUTH, []) == {"missed": 2.0, "extra": 0.0}
    assert touch_scores([], [(0, 1)]) == {"missed": 0.0, "extra": 1.0}


def test_windows_above_rest_are_touches() -> None:
    counts = np.full(100, 5)
    counts[50:60] = 200
    counts[80] = 90
    assert event_touches(counts, 10_000) == [(500_000, 600_000), (800_000, 810_000)]
    assert event_touches(np.full(100, 5), 10_000) == []


def series(seed: int) -> WrenchSeries:
    rng = np.random.default_rng(seed)
    moved = rng.normal(0.0, 1.0, (400, 5, 2)) + rng.normal(0.0, 1.0, (400, 1, 2))
    mean = moved.mean(axis=1)
    length = np.sqrt((moved**2).sum(axis=2)).mean(axis=1)
    wrench = np.column_stack([2.0 * mean, -length])
    return WrenchSeries(np.arange(400), np.zeros((5, 2)), moved, wrench, "mm", f"s{seed}")


def test_the_mean_displacement_learns_a_linear_force() -> None:
    other = series(3)
    estimate = MeanDisplacement([series(1), series(2)]).estimate(other)
    np.testing.assert_allclose(estimate, other.wrench, atol=1e-9)


def test_each_recorded_series_is_predicted_from_the_others(tmp_path) -> None:
    (tmp_path / "force").mkdir()
    for seed in (1, 2):
        one = series(seed)
        np.savez(
            tmp_path / "force" / f"s{seed}.npz",
            t_us=one.t_us,
            reference_mm=np.zeros((5, 3)),
            displacement_mm=np.pad(one.displacement, ((0, 0), (0, 0), (0, 1))),
            wrench=np.pad(one.wrench, ((0, 0), (0, 3))),
        )
    records = force_records(tmp_path, ["mean-displacement"])
    assert [record["trial"]["case"] for record in records] == [
        "force/s1", "force/s2", "force/pooled"
    ]  # fmt: skip
    assert records[-1]["scores"]["r2_fx"] == pytest.approx(1.0)
    lines = lines_of(rows_of(records, METRICS), ["force/pooled"], ["mean-displacement"])
    assert "r2_fx 1" in lines[0]
