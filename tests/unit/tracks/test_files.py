from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.tracks import CSV_COLUMNS, FRAMES_PER_CHUNK, Tracks, create_tracks
from spikingtac.tracks.columns import HEALTH_TYPES
from spikingtac.tracks.files import NpzTracksWriter
from spikingtac.types import MarkerFrame, SourceHealth

REFERENCE_PX = np.array([[10.0, 20.0], [30.0, 40.0]])


def frame(t_us: int) -> MarkerFrame:
    detected = REFERENCE_PX + t_us * 1e-3
    return MarkerFrame(
        t_us=t_us,
        detected_px=detected,
        position_px=detected - 0.5,
        displacement_px=detected - 0.5 - REFERENCE_PX,
        coasted=np.array([False, True]),
        confidence=np.array([0.75, 0.0]),
        health=SourceHealth(gaps=t_us // 2_000, reconnects=1, rate_ev_s=1_234.5),
    )


def written(path: Path, count: int) -> Path:
    writer = create_tracks(path, REFERENCE_PX)
    for k in range(count):
        writer.write(frame(1_000 * k))
    writer.close({"losses": {"gap": 2}})
    return path


@pytest.mark.parametrize("count", [0, 3, FRAMES_PER_CHUNK + 5])
def test_npz_keeps_every_frame(tmp_path: Path, count: int) -> None:
    tracks = Tracks.load(written(tmp_path / "t.npz", count))
    assert tracks.t_us.dtype == np.int64
    assert tracks.t_us.tolist() == [1_000 * k for k in range(count)]
    for name, dtype in (
        ("detected_px", np.float32),
        ("held", np.bool_),
        ("confidence", np.float32),
    ):
        array = getattr(tracks, name)
        assert array.dtype == dtype
        assert array.shape[:2] == (count, 2)
    np.testing.assert_allclose(tracks.displacement_px, tracks.position_px - REFERENCE_PX, atol=1e-4)
    assert tracks.meta == {"losses": {"gap": 2}}
    assert tracks.gaps is not None
    assert tracks.gaps.tolist() == [k // 2 for k in range(count)]
    assert [row.health for row in tracks.frames()] == [
        frame(1_000 * k).health for k in range(count)
    ]


def test_what_was_measured_lies_beside_the_frames(tmp_path: Path) -> None:
    writer = NpzTracksWriter(tmp_path / "t.npz", REFERENCE_PX)
    for k in range(FRAMES_PER_CHUNK + 5):
        wrench = np.array([k, 0.0, -1.0])
        writer.measure(
            {
                "wrench_estimate": wrench,
                "wrench_half_width": 0.1 * np.abs(wrench),
                "wrench_distance": np.array(0.5),
            }
        )
        writer.write(frame(1_000 * k))
    writer.close({})
    tracks = Tracks.load(tmp_path / "t.npz")
    assert tracks.wrench_estimate is not None
    assert tracks.wrench_distance is not None
    np.testing.assert_array_equal(tracks.wrench_estimate[:, 0], np.arange(FRAMES_PER_CHUNK + 5))
    assert tracks.wrench_distance.shape == (FRAMES_PER_CHUNK + 5,)
    assert Tracks.load(written(tmp_path / "bare.npz", 2)).wrench_estimate is None


def test_equal_frames_give_equal_bytes(tmp_path: Path) -> None:
    first, second = written(tmp_path / "a.npz", 20), written(tmp_path / "b.npz", 20)
    assert first.read_bytes() == second.read_bytes()


def test_files_without_health_are_read(tmp_path: Path) -> None:
    arrays = dict(np.load(written(tmp_path / "t.npz", 3)))
    for name in HEALTH_TYPES:
        del arrays[name]
    np.savez(tmp_path / "old.npz", **arrays)
    tracks = Tracks.load(tmp_path / "old.npz")
    assert tracks.gaps is None
    assert tracks.summary()["health"] is None
    assert next(tracks.frames()).health == SourceHealth()
    np.savez(tmp_path / "odd.npz", **arrays, gaps=np.zeros(2, np.int32))
    with pytest.raises(RecordingError, match="gaps has shape"):
        Tracks.load(tmp_path / "odd.npz")


def test_csv_is_the_same_in_long_form(tmp_path: Path) -> None:
    path = written(tmp_path / "t.csv", 3)
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert len(rows) == 6
    assert float(rows[5]["position_x_px"]) == pytest.approx(30.0 + 2.0 - 0.5)
    assert rows[5]["held"] == "1"
    assert json.loads((tmp_path / "t.csv.json").read_text())["losses"] == {"gap": 2}


def test_other_endings_and_missing_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.npz, \.csv or \.parquet"):
        create_tracks(tmp_path / "t.mat", REFERENCE_PX)
    with pytest.raises(ConfigError, match="does not exist"):
        create_tracks(tmp_path / "no" / "t.npz", REFERENCE_PX)


def test_a_foreign_file_is_no_tracks(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez(path, t_us=np.arange(3))
    with pytest.raises(RecordingError, match="holds no tracks"):
        Tracks.load(path)
    with pytest.raises(RecordingError, match="holds no tracks"):
        Tracks.load(tmp_path / "missing.npz")
