import numpy as np
import pytest

from spikingtac_paper.collision.frames import (
    FrameSampler,
    FrameSamplingConfig,
    displacement_sum_px,
    exposures_us,
    measured_px,
    quiet_threshold_px,
)

EXACT = FrameSamplingConfig(noise_px=0.0)
REST = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 37.0


def moving(speed_px_s: float, length_us: int) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0, length_us + 1, 1000).astype(float)
    shift = speed_px_s * times * 1e-6
    return times, REST + np.stack([shift, 0 * shift], axis=-1)[:, None, :]


def test_the_sum_is_the_published_one() -> None:
    moved = REST + np.array([3.0, 4.0])
    assert displacement_sum_px(moved[None], REST) == pytest.approx([64 * 5.0])


def test_exposures_are_regular_half_open_and_keep_their_phase() -> None:
    times = exposures_us(EXACT, 0.25, 0, 1_000_000)
    assert len(times) == 32
    assert times[0] == pytest.approx(0.25 * 31_250.0)
    assert np.diff(times) == pytest.approx(np.full(31, 31_250.0))
    parts = [exposures_us(EXACT, 0.25, k * 7_000, (k + 1) * 7_000) for k in range(100)]
    assert np.concatenate(parts) == pytest.approx(exposures_us(EXACT, 0.25, 0, 700_000))


def test_frames_see_the_truth_at_their_exposure_with_the_declared_noise() -> None:
    truth = moving(100.0, 50_000)
    seen = measured_px(EXACT, np.array([10_500.0]), truth, np.random.default_rng(0))
    assert seen[0] == pytest.approx(REST + np.array([1.05, 0.0]))
    noisy = FrameSamplingConfig(noise_px=0.1)
    times = np.linspace(0.0, 5e4, 200)
    spread = measured_px(noisy, times, truth, np.random.default_rng(0)) - measured_px(
        EXACT, times, truth, np.random.default_rng(0)
    )
    assert spread.std() == pytest.approx(0.1, rel=0.02)


def test_the_threshold_bounds_the_quiet_interval_and_keeps_the_budget() -> None:
    sums = np.random.default_rng(1).normal(8.0, 0.5, 2_000)
    threshold = quiet_threshold_px(EXACT, sums)
    assert threshold >= sums.max()
    assert threshold == pytest.approx(8.0 + 4.29 * 0.5, rel=0.01)
    outlier = np.append(sums, 30.0)
    assert quiet_threshold_px(EXACT, outlier) == 30.0
    with pytest.raises(ValueError, match="at least 50"):
        quiet_threshold_px(EXACT, sums[:10])


def test_contact_is_seen_in_the_first_frame_beyond_the_threshold() -> None:
    sampler = FrameSampler(EXACT, 64.0, 0.5, np.random.default_rng(0))
    sampler.start(REST)
    times, centers = moving(20.0, 200_000)  # 1 px per marker at 50 ms; frames at 46.9, 78.1 ms
    assert sampler.look((times[:60], centers[:60])) is None
    assert sampler.look((times[59:], centers[59:])) == pytest.approx(2.5 * 31_250.0)


def test_numbers_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="rate_hz"):
        FrameSamplingConfig(rate_hz=0.0)
