import numpy as np
import pytest

from spikingtac_paper.collision import approach
from spikingtac_paper.collision.approach import (
    FrameSampler,
    exposures_us,
    measured_px,
    quiet_threshold_px,
)

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


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(approach, "NOISE_PX", 0.0)


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


@pytest.mark.usefixtures("exact")
def test_contact_is_seen_in_the_first_frame_beyond_the_threshold() -> None:
    sampler = FrameSampler(64.0, 0.5, np.random.default_rng(0))
    sampler.start(REST)
    times, centers = moving(20.0, 200_000)  # 1 px per marker at 50 ms; frames at 46.9, 78.1 ms
    assert sampler.look((times[:60], centers[:60])) is None
    assert sampler.look((times[59:], centers[59:])) == pytest.approx(2.5 * 31_250.0)
