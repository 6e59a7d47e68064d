"""Scores of the experiment on real gels, on cases that can be computed by hand."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import RecordingError
from spikingtac_paper.real_gels import Plateaus, matched, plateau_scores, truth_scores
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction
from stand_ins.known import known

REST_PX = np.array([[30.0, 30.0], [60.0, 30.0], [30.0, 60.0]])
BURST_US = np.arange(1, 7)[:, None] * 1_000_000 + np.array([0, 200_000])
T_US = np.arange(0, 7_000_000, 10_000)


def calibration(rest_px: np.ndarray = REST_PX) -> Calibration:
    return known(rest_px, 6.0, (600, 600))


def places() -> np.ndarray:
    pressed = np.arange(7) % 2 == 1
    return np.where(
        pressed[None, :, None], REST_PX[:, None] + np.array([3.0, 0.0]), REST_PX[:, None]
    )


def prediction(offset_px: float) -> Prediction:
    plateau = np.searchsorted(BURST_US[:, 1], T_US, side="right")
    detected_px = places()[:, plateau].transpose(1, 0, 2) + np.array([offset_px, 0.0])
    shown = detected_px.astype(np.float32)
    return Prediction(T_US + 77, shown, shown, REST_PX)


@pytest.fixture
def plateaus(tmp_path: Path) -> Plateaus:
    path = tmp_path / "reference.npz"
    np.savez(path, burst_us=BURST_US, plateau_px=places(), rest_px=REST_PX)
    return Plateaus.load(path)


def test_an_offset_is_the_error_at_every_plateau(plateaus: Plateaus) -> None:
    scores = plateau_scores(prediction(0.25), plateaus, calibration())
    for name in ("pressed_mean_px", "released_mean_px", "plateau_max_px", "return_median_px"):
        assert scores[name] == pytest.approx(0.25, abs=1e-5), name
    assert scores["lost_markers"] == scores["missing_markers"] == 0


def test_a_marker_that_stays_away_is_lost(plateaus: Plateaus) -> None:
    moved = prediction(0.0)
    moved.detected_px[:, 1] += 6.0
    scores = plateau_scores(moved, plateaus, calibration())
    assert scores["lost_markers"] == 1
    assert scores["return_median_px"] == pytest.approx(6.0 * 2**0.5, abs=1e-4)


def test_markers_are_matched_by_place_in_any_order() -> None:
    own, other = matched(REST_PX[[2, 0, 1]] + 1.0, REST_PX)
    assert dict(zip(own.tolist(), other.tolist(), strict=True)) == {0: 2, 1: 0, 2: 1}
    assert len(matched(REST_PX + 500.0, REST_PX)[0]) == 0


def test_errors_against_truth() -> None:
    truth = GroundTruth.of(
        {"marker_t_us": np.array([0, 7_000_000]), "marker_px": np.stack([REST_PX, REST_PX]),
         "reference_px": REST_PX, "radius_px": np.full(3, 6.0)}
    )  # fmt: skip
    still_px = np.tile(REST_PX + np.array([0.0, 0.5]), (len(T_US), 1, 1)).astype(np.float32)
    still = Prediction(T_US, still_px, still_px, REST_PX)
    scores = truth_scores(still, truth, calibration(REST_PX + np.array([0.2, 0.0])))
    assert scores["error_mean_px"] == pytest.approx(0.5, abs=1e-5)
    assert scores["rest_max_px"] == pytest.approx(0.2)
    with pytest.raises(RecordingError, match="near a known one"):
        truth_scores(still, truth, calibration(REST_PX + 500.0))


def test_a_file_without_places_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", burst_us=BURST_US)
    with pytest.raises(RecordingError, match="read as standing places"):
        Plateaus.load(tmp_path / "a.npz")
