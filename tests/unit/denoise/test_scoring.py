import numpy as np
import pytest

from spikingtac.denoise.classical import CLASSICAL_DENOISERS
from spikingtac_paper.denoise import (
    ACTIVITY,
    FILTER_PRODUCT,
    LONGEST_FILTER_US,
    METHODS,
    METRICS,
    CleanRecording,
    Plan,
    Sample,
    clean_centroids,
    distance_px,
    measured,
    render,
    report_rows,
    score_all,
    window_us,
)
from spikingtac_paper.harness.report import Row
from spikingtac_paper.training.dataset import with_background, with_drops
from spikingtac_paper.trials.trajectories import GroundTruth
from stand_ins.denoiser_training import RADIUS_PX, moving_disc

PLAN = Plan(first_us=50_000, every_us=50_000)


@pytest.fixture
def recording() -> CleanRecording:
    clip = moving_disc()
    y, x = np.nonzero(clip.start)
    second = np.array([[x.mean(), y.mean()], [200.0, 200.0]])  # beyond the border: never found
    still = np.zeros(1, np.int64), np.zeros((1, 2, 2)), second, np.full(2, RADIUS_PX)
    return CleanRecording("disc", clip.events, GroundTruth(*still, 0), "twin")


def excess(recording: CleanRecording, noise_hz: float, drop: float, kind="binary"):
    reference = clean_centroids(recording, kind, PLAN)
    random = np.random.default_rng(1)
    events = with_background(with_drops(recording.events, drop, random), noise_hz, random)
    denoisers = {name: build() for name, build in CLASSICAL_DENOISERS.items()}
    told = measured(recording, events, kind, reference, denoisers)
    assert all((step_us > 0).all() for _, step_us in told.values())
    return reference, distance_px(told["none"][0], reference.center_px)


@pytest.mark.parametrize("kind", ["binary", "graded"])
def test_without_degradation_nothing_is_in_excess_and_noise_costs(recording, kind):
    reference, error_px = excess(recording, 0.0, 0.0, kind)
    assert reference.found[:, 0].all()
    assert not reference.found[:, 1].any()
    assert error_px[:, 0] == pytest.approx(0.0, abs=1e-5)
    assert np.isnan(error_px[:, 1]).all()
    assert np.nanmean(excess(recording, 1.0, 0.5, kind)[1][:, 0]) > 0.05


def test_rows_count_what_was_found():
    nan = float("nan")
    sample = Sample(
        np.array([0.2, 0.4, nan, nan]), np.array([1.0, 3.0, nan, nan]), np.array([5.0]), "twin"
    )
    empty = sample._replace(excess_px=np.empty(0), centroid_px=np.empty(0))
    rows = report_rows([{("c", "none"): [sample]}, {("fast/c", "none"): [empty]}])
    assert all(isinstance(row, Row) for row in rows)
    assert {row.case for row in rows} == {"c"}
    values = {row.metric: (row.value, row.n) for row in rows}
    assert values["recall"] == (0.5, 4)
    assert values["excess_mean_px"] == (pytest.approx(0.3), 2)
    assert values["centroid_mean_px"] == (pytest.approx(2.0), 2)
    assert values["step_p50_us"] == (5.0, 1)


def test_the_window_follows_the_background():
    assert window_us(1.0) == round(1e6 * FILTER_PRODUCT)
    assert window_us(5.0) == round(1e6 * FILTER_PRODUCT / 5.0)
    assert window_us(0.001) == LONGEST_FILTER_US
    assert METHODS[-1] == "supervised"


SEED, DURATION_S = 1001, 1.2


@pytest.fixture(scope="module")
def rows():
    plan = Plan(
        noise_hz=(1.0,), drop=(0.5,), duration_s=DURATION_S, every_us=100_000, first_us=600_000
    )
    return report_rows([score_all(render("finger-torsion", SEED, DURATION_S), plan, SEED)])


def test_every_method_case_and_metric_is_there(rows):
    methods = {prefix + name for prefix in ("", ACTIVITY) for name in METHODS}
    assert {row.method for row in rows} == methods
    cases = {row.case for row in rows}
    for kind in ("binary", "graded"):
        assert {f"{kind}@1.0-0.5", f"slow/{kind}@1.0-0.5", f"heldout/{kind}@1.0-0.5"} <= cases
    for row in rows:
        assert row.unit == METRICS[row.metric].unit
        assert row.source == "twin"
        assert row.n > 0 or row.value is None


def test_the_filter_and_the_network_find_every_marker(rows):
    table = {(row.method, row.case, row.metric): row.value for row in rows}
    assert table[f"{ACTIVITY}network-int8", "binary@1.0-0.5", "recall"] == 1.0
    noisy = table[f"{ACTIVITY}none", "binary@1.0-0.5", "excess_mean_px"]
    assert table[f"{ACTIVITY}network-int8", "binary@1.0-0.5", "excess_mean_px"] < noisy
