"""``track`` as a user writes it: paths in, tracks out, equal to what the verb writes."""

import csv
from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac.events.formats.codec import Triggers
from spikingtac.pipeline.track import track_to_file
from stand_ins.random_packets import save_events


def test_paths_and_objects_give_what_the_file_holds(circling: Path) -> None:
    calibration = st.Calibration.load(circling / "calibration.json")
    tracks = st.track(
        str(circling), calibration=circling / "calibration.json", preset="fast", rate_hz=500
    )
    again = st.track(st.open_events(circling), calibration, "fast", rate_hz=500)
    config = st.load_config("fast").with_tracking(rate_hz=500)
    track_to_file(st.open_events(circling), circling / "t.npz", config.tracking, calibration)
    written = st.Tracks.load(circling / "t.npz")
    for one in (again, written):
        np.testing.assert_array_equal(tracks.t_us, one.t_us)
        np.testing.assert_array_equal(tracks.detected_px, one.detected_px)
    assert tracks.meta["config"] == written.meta["config"]


def test_triggers_of_the_recording_are_in_the_tracks(circling: Path, tmp_path: Path) -> None:
    packets, edges = list(st.open_events(circling)), Triggers()
    first_us = int(packets[0].t[0])
    edges.append([first_us + 2_500, first_us + 7_000], 3, [True, False])
    save_events(tmp_path / "e.npz", *packets, triggers=edges)
    calibration, config = st.Calibration.load(circling / "calibration.json"), st.load_config("fast")
    tracking = config.with_tracking(rate_hz=500).tracking
    for name in ("t.npz", "t.csv"):
        source = st.open_events(tmp_path / "e.npz")
        track_to_file(source, tmp_path / name, tracking, calibration)
    for tracks in (
        st.Tracks.load(tmp_path / "t.npz"),
        st.track(tmp_path / "e.npz", calibration, config, rate_hz=500),
    ):
        found = (tracks.trigger_t_us, tracks.trigger_channel, tracks.trigger_edge)
        for one, other in zip(found, edges.columns().values(), strict=True):
            np.testing.assert_array_equal(one, other)
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    marked = {(int(row["t_us"]) - first_us, row["trigger"]) for row in rows if row["trigger"]}
    assert marked == {(4_000, "3"), (8_000, "3")}


def test_smoothed_tracks_hold_their_deviations_in_memory_and_in_files(
    circling: Path, tmp_path: Path
) -> None:
    calibration = st.Calibration.load(circling / "calibration.json")
    causal, smooth = (
        st.track(circling, calibration, "fast", rate_hz=500, smooth=told) for told in (False, True)
    )
    assert causal.sigma_px is None
    tracking = st.load_config("fast").with_tracking(rate_hz=500, smooth=True).tracking
    for name in ("t.npz", "t.csv"):
        track_to_file(st.open_events(circling), tmp_path / name, tracking, calibration)
    written = st.Tracks.load(tmp_path / "t.npz")
    for key in ("detected_px", "displacement_px", "sigma_px"):
        np.testing.assert_array_equal(getattr(written, key), getattr(smooth, key))
    assert smooth.sigma_px.shape == smooth.detected_px.shape
    assert 0.0 < np.abs(smooth.detected_px - causal.detected_px).mean() < 0.2
    assert "sigma_x_px" in (tmp_path / "t.csv").read_text().partition("\n")[0]
    smooth.save(tmp_path / "again.npz")
    np.testing.assert_array_equal(st.Tracks.load(tmp_path / "again.npz").sigma_px, smooth.sigma_px)
    with pytest.raises(st.SpikingTacError, match="BlobTracker cannot be smoothed"):
        st.track(circling, calibration, "paper", smooth=True)


def test_mistakes_are_told(circling: Path) -> None:
    with pytest.raises(st.SpikingTacError, match="unknown preset 'fats'; did you mean 'fast'"):
        st.track(circling, circling / "calibration.json", preset="fats")
    with pytest.raises(st.SpikingTacError, match=r"no\.json"):
        st.track(circling, "no.json")
