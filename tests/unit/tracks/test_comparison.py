"""Distances of two tracks, and of tracks to a truth, against what was put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.tracks.comparison import compare_tracks, compare_with_truth
from stand_ins.tracks import HELD_MARKER, circling_tracks
from stand_ins.viewer import positions_px


def test_a_shift_is_found_at_every_marker_and_time() -> None:
    found = compare_tracks(circling_tracks(), circling_tracks(off_px=0.25))
    assert found.error_px.shape == (500, 64)
    np.testing.assert_allclose(found.error_px, 0.25, atol=1e-4)
    summary = found.summary()
    for name in ("error_mean_px", "error_p50_px", "error_p95_px", "error_max_px"):
        assert summary[name] == pytest.approx(0.25, abs=1e-4)
    assert summary["error_mean_mm"] is None
    assert len(found.by_marker()) == 64


def test_a_truth_at_other_times_is_interpolated() -> None:
    tracks = circling_tracks(px_per_mm=10.0)
    times_us = np.arange(0, 400_001, 2_000)
    truth = np.stack([positions_px(t_us) for t_us in times_us])
    found = compare_with_truth(tracks, times_us, truth)
    assert found.t_us[-1] <= 400_000 < found.t_us[-1] + 1_000
    # A chord of 2 ms of a circle of 6 px and 1 s leaves it by 6 (2 pi)^2 2e-3^2 / 8 px.
    assert found.error_px.max() < 2e-4
    assert found.summary()["error_mean_mm"] == pytest.approx(found.error_px.mean() / 10.0)


def test_coasted_markers_are_told_apart() -> None:
    one = circling_tracks()
    detected = one.detected_px.copy()
    detected[:, HELD_MARKER] += 5.0
    truth = np.stack([positions_px(t_us) for t_us in one.t_us.tolist()])
    found = compare_with_truth(replace(one, detected_px=detected), one.t_us, truth)
    summary = found.summary()
    assert summary["worst_marker"] == HELD_MARKER
    assert summary["error_mean_px"] > 0.1
    assert summary["error_seen_mean_px"] < 1e-3


def test_one_position_is_compared_with_that_time_alone() -> None:
    one = circling_tracks()
    found = compare_with_truth(one, one.t_us[5:6], one.detected_px[5:6])
    assert found.t_us.tolist() == [one.t_us[5]]
    assert found.error_px.max() == 0.0


def test_other_sensors_and_other_times_are_refused() -> None:
    one = circling_tracks()
    with pytest.raises(ConfigError, match="64 markers, the other 3"):
        compare_with_truth(one, one.t_us, one.detected_px[:, :3])
    with pytest.raises(ConfigError, match="no time in common"):
        compare_tracks(one, replace(one, t_us=one.t_us + 10**9))
    with pytest.raises(ConfigError, match="no time in common"):
        compare_tracks(one, circling_tracks(estimates=0))
