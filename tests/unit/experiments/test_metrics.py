import numpy as np
import pytest

from spikingtac.markers.laws import anchored_px
from spikingtac_paper.trials.metrics import (
    POINT_METRICS,
    longest_duration_us,
    nearest_another,
    point_scores,
)
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction

REST = np.array([[50.0, 50.0], [90.0, 50.0], [50.0, 90.0], [90.0, 90.0]])
TIMES_US = np.arange(0, 1_000_000, 2_000)


def truth() -> GroundTruth:
    return GroundTruth(TIMES_US, moving(), REST, np.full(4, 7.0), released_us=600_000)


def said(detected_px: np.ndarray, position_px: np.ndarray | None = None) -> Prediction:
    given = detected_px if position_px is None else position_px
    return Prediction(TIMES_US, detected_px.astype(np.float32), given.astype(np.float32), REST)


def moving() -> np.ndarray:
    course = np.tile(REST, (len(TIMES_US), 1, 1))
    course[:, :, 0] += 10.0 * np.sin(np.linspace(0.0, np.pi, len(TIMES_US)))[:, None]
    return course


def test_the_truth_scores_perfectly() -> None:
    scores = point_scores(said(moving()), truth())
    assert set(scores) == {metric.name for metric in POINT_METRICS}
    assert scores["success_rate"] == 1.0
    assert scores["error_mean_px"] == pytest.approx(0.0, abs=1e-5)
    assert scores["lost_markers"] == scores["id_swaps"] == 0.0


def test_a_constant_offset_shows_in_each_metric_as_defined() -> None:
    scores = point_scores(said(moving() + np.array([0.6, 0.8])), truth())
    for name in ("error_mean_px", "error_p95_px", "error_final_px", "return_error_mean_px"):
        assert scores[name] == pytest.approx(1.0, abs=1e-4)
    assert scores["return_mean_px"] == pytest.approx(1.0, abs=1e-4)
    assert scores["return_std_px"] == pytest.approx(0.0, abs=1e-4)
    zeroed = float(anchored_px(np.array(1.0)))
    assert scores["zeroed_return_mean_px"] == pytest.approx(zeroed, abs=1e-3)


def test_the_return_is_that_of_the_given_position_and_the_error_that_of_the_detected() -> None:
    scores = point_scores(said(moving(), moving() + np.array([6.0, 0.0])), truth())
    assert scores["return_mean_px"] == pytest.approx(6.0, abs=1e-4)
    assert scores["success_rate"] == 0.0
    assert scores["error_mean_px"] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("samples", "lost"), [(25, 0.0), (27, 1.0)])
def test_lost_means_more_than_fifty_milliseconds(samples: int, lost: float) -> None:
    off = moving()
    off[100 : 100 + samples, 1, 0] += 6.0
    assert point_scores(said(off), truth())["lost_markers"] == lost


def test_exchanged_identities_are_counted() -> None:
    swapped = moving()
    swapped[200:, [0, 1]] = swapped[200:, [1, 0]]
    assert point_scores(said(swapped), truth())["id_swaps"] == 2.0


def test_damaged_markers_are_not_asked_for_but_stay_as_a_place_to_be_mistaken_for() -> None:
    off = moving()
    off[:, 3] += 30.0
    scores = point_scores(said(off), truth(), damaged=(3,))
    assert scores["error_mean_px"] == pytest.approx(0.0, abs=1e-5)
    stolen = moving()
    stolen[:, 2] = stolen[:, 3]
    assert point_scores(said(stolen), truth(), damaged=(3,))["id_swaps"] == 1.0


def test_longest_duration_against_a_plain_loop() -> None:
    rng = np.random.default_rng(5)
    away = rng.random((200, 6)) < 0.7
    t_us = np.cumsum(rng.integers(1, 50, 200))
    ends = np.append(t_us[1:], t_us[-1])
    expected = []
    for marker in range(6):
        longest, start = 0, None
        for i in range(200):
            if away[i, marker]:
                start = t_us[i] if start is None else start
                longest = max(longest, ends[i] - start)
            else:
                start = None
        expected.append(longest)
    assert longest_duration_us(away, t_us).tolist() == expected


def test_nearest_another_against_all_distances() -> None:
    rng = np.random.default_rng(6)
    true_px = np.tile(REST, (50, 1, 1))
    detected = true_px + rng.normal(0.0, 20.0, true_px.shape)
    distance = np.linalg.norm(detected[:, :, None] - true_px[:, None], axis=3)
    expected = distance.argmin(axis=2) != np.arange(4)
    assert expected.any()
    assert np.array_equal(nearest_another(detected, true_px, np.arange(4)), expected)


def test_the_release_is_the_end_of_the_last_contact() -> None:
    columns = {
        "marker_t_us": np.array([0, 9_000]),
        "marker_px": np.zeros((2, 1, 2)),
        "reference_px": np.zeros((1, 2)),
        "radius_px": np.ones(1),
        "contact_t_us": np.arange(0, 9_000, 1_000),
        "force_n": np.zeros((9, 3)),
    }
    columns["force_n"][2:5, 2] = 1.0
    assert GroundTruth.of(columns).released_us == 5_000
    columns["force_n"][7, 0] = -1.0
    assert GroundTruth.of(columns).released_us == 8_000
