"""``track`` as a user writes it: paths in, tracks out, equal to what the verb writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import spikingtac as st
from spikingtac.pipeline.track import track_to_file
from stand_ins.viewer import record_circling


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_circling(tmp_path_factory.mktemp("recording"))


def test_paths_and_objects_give_what_the_file_holds(folder: Path) -> None:
    calibration = st.Calibration.load(folder / "calibration.json")
    tracks = st.track(
        str(folder), calibration=folder / "calibration.json", preset="fast", rate_hz=500
    )
    again = st.track(st.open_events(folder), calibration, "fast", rate_hz=500)
    config = st.load_config("fast").with_tracking(rate_hz=500)
    track_to_file(st.open_events(folder), folder / "t.npz", config.tracking, calibration)
    written = st.Tracks.load(folder / "t.npz")
    for one in (again, written):
        np.testing.assert_array_equal(tracks.t_us, one.t_us)
        np.testing.assert_array_equal(tracks.detected_px, one.detected_px)
    assert tracks.meta["config"] == written.meta["config"]


def test_mistakes_are_told(folder: Path) -> None:
    with pytest.raises(st.SpikingTacError, match="unknown preset 'fats'; did you mean 'fast'"):
        st.track(folder, folder / "calibration.json", preset="fats")
    with pytest.raises(st.SpikingTacError, match=r"no\.json"):
        st.track(folder, "no.json")
