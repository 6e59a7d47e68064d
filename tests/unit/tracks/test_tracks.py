"""Tracks in memory: figures, scale, tables, and what is written is read."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.tracks import CSV_COLUMNS, Tracks, is_tracks_file
from stand_ins.tracks import circling_tracks


def test_the_summary_is_what_was_put_in() -> None:
    found = circling_tracks().summary()
    assert (found["markers"], found["estimates"]) == (64, 500)
    assert (found["t_first_us"], found["t_last_us"], found["rate_hz"]) == (7, 499_007, 1_000.0)
    assert found["duration_s"] == pytest.approx(0.499)
    # The outermost markers circle widest; they are furthest from rest half a turn on.
    assert found["displacement_max_px"] == pytest.approx(12.2, abs=0.1)
    assert found["displacement_max_marker"] in (0, 7, 56, 63)
    assert found["displacement_max_t_us"] == 499_007
    assert found["held_share"] == pytest.approx(1 / 64)
    assert found["never_observed"] == [9]
    assert found["displacement_max_mm"] is None


def test_the_scale_makes_millimetres() -> None:
    tracks = circling_tracks(px_per_mm=15.5)
    np.testing.assert_allclose(tracks.displacement_mm * 15.5, tracks.displacement_px, rtol=1e-6)
    found = tracks.summary()
    assert found["displacement_max_mm"] == pytest.approx(found["displacement_max_px"] / 15.5)
    with pytest.raises(ConfigError, match="--pitch-mm"):
        _ = circling_tracks().displacement_mm


def test_they_print_as_one_line() -> None:
    text = repr(circling_tracks())
    assert "64 markers, 500 estimates in 0.499 s" in text
    assert "\n" not in text


def test_tracks_without_an_estimate_have_a_summary() -> None:
    found = circling_tracks(estimates=0).summary()
    assert (found["estimates"], found["displacement_max_px"]) == (0, 0.0)
    assert found["rate_hz"] is found["t_first_us"] is None
    assert found["never_observed"] == []


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    tracks = circling_tracks(px_per_mm=15.5)
    tracks.save(tmp_path / "tracks.npz")
    again = Tracks.load(tmp_path / "tracks.npz")
    for name in ("t_us", "detected_px", "position_px", "coasted", "confidence", "reference_px"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tracks, name))
    assert again.meta == tracks.meta
    assert is_tracks_file(tmp_path / "tracks.npz")
    np.savez(tmp_path / "events.npz", t=np.arange(3))
    assert not is_tracks_file(tmp_path / "events.npz")
    assert not is_tracks_file(tmp_path / "missing.npz")


def test_the_table_is_the_csv_file(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    tracks = circling_tracks(estimates=5)
    table = tracks.to_pandas()
    assert tuple(table.columns) == CSV_COLUMNS
    tracks.save(tmp_path / "tracks.csv")
    rows = list(csv.DictReader((tmp_path / "tracks.csv").read_text().splitlines()))
    written = pandas.DataFrame(rows).astype(float)
    np.testing.assert_allclose(table.to_numpy(float), written.to_numpy(), atol=6e-4)
    assert {"displacement_x_mm", "displacement_y_mm"} <= set(
        circling_tracks(estimates=5, px_per_mm=15.5).to_pandas().columns
    )
