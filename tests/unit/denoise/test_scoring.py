import dataclasses

import numpy as np
import pytest

from spikingtac.denoise.classical import CLASSICAL_DENOISERS
from spikingtac_paper.denoise.experiment import (
    FILTER_PRODUCT,
    METHODS,
    DenoiseConfig,
    Sample,
    report_rows,
)
from spikingtac_paper.denoise.scoring import (
    ACTIVITY,
    CleanRecording,
    Degradation,
    clean_centroids,
    score_recording,
)
from spikingtac_paper.harness.report import Row
from stand_ins.denoiser_training import RADIUS_PX, moving_disc

FIRST_US, EVERY_US = 50_000, 50_000


@pytest.fixture
def recording() -> CleanRecording:
    clip = moving_disc()
    y, x = np.nonzero(clip.start)
    second = np.array([[x.mean(), y.mean()], [200.0, 200.0]])  # beyond the border: never found
    truth = np.zeros(1, np.int64), np.zeros((1, 2, 2), np.float32)
    return CleanRecording("disc", clip.events, second, np.full(2, RADIUS_PX), "twin", *truth)


def scored(recording: CleanRecording, noise_hz: float, drop: float, kind="binary"):
    reference = clean_centroids(recording, kind, EVERY_US, FIRST_US)
    degradation = Degradation(noise_hz=noise_hz, drop=drop, window_us=20_000, seed=1)
    denoisers = {name: build() for name, build in CLASSICAL_DENOISERS.items()}
    return reference, score_recording(recording, kind, degradation, reference, denoisers)


@pytest.mark.parametrize("kind", ["binary", "graded"])
def test_without_degradation_nothing_is_in_excess(recording, kind):
    reference, scores = scored(recording, 0.0, 0.0, kind)
    assert reference.found[:, 0].all()
    assert not reference.found[:, 1].any()
    assert scores["none"].error_px[:, 0] == pytest.approx(0.0, abs=1e-5)
    assert np.isnan(scores["none"].error_px[:, 1]).all()


def test_noise_and_drops_cost_and_the_filter_is_named(recording):
    _, scores = scored(recording, 1.0, 0.5)
    assert set(scores) == {*CLASSICAL_DENOISERS, *(ACTIVITY + name for name in CLASSICAL_DENOISERS)}
    assert np.nanmean(scores["none"].error_px[:, 0]) > 0.05
    assert all((score.step_us > 0).all() for score in scores.values())


def test_rows_count_what_was_found():
    nan = float("nan")
    sample = Sample(
        np.array([0.2, 0.4, nan, nan]), np.array([1.0, 3.0, nan, nan]), np.array([5.0]), "twin"
    )
    empty = dataclasses.replace(sample, excess_px=np.empty(0), centroid_px=np.empty(0))
    rows = report_rows([{("c", "none"): [sample]}, {("fast/c", "none"): [empty]}])
    assert all(isinstance(row, Row) for row in rows)
    assert {row.case for row in rows} == {"c"}
    values = {row.metric: (row.value, row.n) for row in rows}
    assert values["recall"] == (0.5, 4)
    assert values["excess_mean_px"] == (pytest.approx(0.3), 2)
    assert values["centroid_mean_px"] == (pytest.approx(2.0), 2)
    assert values["step_p50_us"] == (5.0, 1)


def test_the_window_follows_the_background():
    config = DenoiseConfig()
    assert config.window_us(1.0) == round(1e6 * FILTER_PRODUCT)
    assert config.window_us(5.0) == round(1e6 * FILTER_PRODUCT / 5.0)
    assert config.window_us(0.001) == config.longest_us
    assert METHODS[-1] == "supervised"
