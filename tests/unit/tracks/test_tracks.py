"""Tracks in memory and on disk: figures, scale, forces, tables, distances."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.tracks import FRAMES_PER_CHUNK, Tracks, create_tracks
from spikingtac.tracks.comparison import compare_tracks, compare_with_truth
from spikingtac.types import MarkerFrame, SourceHealth
from stand_ins.known import known
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import positions_px

CSV_COLUMNS = (
    *("t_us", "marker", "detected_x_px", "detected_y_px", "position_x_px", "position_y_px"),
    *("displacement_x_px", "displacement_y_px", "held", "confidence"),
)
REFERENCE_PX = np.array([[10.0, 20.0], [30.0, 40.0]])


def frame(t_us: int) -> MarkerFrame:
    detected = REFERENCE_PX + t_us * 1e-3
    position, held = detected - 0.5, np.array([False, True])
    health = SourceHealth(gaps=t_us // 2_000, reconnects=1, rate_ev_s=1_234.5)
    return MarkerFrame(
        t_us, detected, position, position - REFERENCE_PX, held, ~held * 0.75, health
    )


def written(path: Path, count: int) -> Path:
    with create_tracks(path, REFERENCE_PX) as writer:
        writer.meta = {"losses": {"gap": 2}}
        for k in range(count):
            writer.write(frame(1_000 * k))
    return path


def felt(tracks: Tracks) -> Tracks:
    force = np.arange(3.0 * len(tracks.t_us), dtype=np.float32).reshape(-1, 3)
    return replace(tracks, force_n=force, force_sigma_n=force / 10)


@pytest.mark.parametrize("count", [0, 3, FRAMES_PER_CHUNK + 5])
def test_npz_keeps_every_frame(tmp_path: Path, count: int) -> None:
    tracks = Tracks.load(written(tmp_path / "t.npz", count))
    assert tracks.t_us.tolist() == [1_000 * k for k in range(count)]
    assert tracks.displacement_px.shape == (count, 2, 2)
    assert (tracks.t_us.dtype, tracks.detected_px.dtype) == (np.int64, np.float32)
    np.testing.assert_allclose(tracks.displacement_px, tracks.position_px - REFERENCE_PX, atol=1e-4)
    assert tracks.meta == {"losses": {"gap": 2}}
    expected = [frame(1_000 * k).health for k in range(count)]
    assert [row.health for row in tracks.frames()] == expected
    again = written(tmp_path / "again.npz", count)  # equal frames, equal bytes
    assert again.read_bytes() == (tmp_path / "t.npz").read_bytes()


def test_what_holds_no_tracks_and_cannot_be_written_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", t_us=np.arange(3))
    for name in ("x.npz", "missing.npz"):
        with pytest.raises(RecordingError, match="holds no tracks"):
            Tracks.load(tmp_path / name)
    with pytest.raises(ConfigError, match=r"valid endings: \.npz, \.csv, \.parquet"):
        create_tracks(tmp_path / "t.mat", REFERENCE_PX)
    with pytest.raises(ConfigError, match="does not exist"):
        create_tracks(tmp_path / "no" / "t.npz", REFERENCE_PX)


def test_frames_are_gathered_and_what_is_saved_is_loaded(tmp_path: Path) -> None:
    tracks = felt(circling_tracks(estimates=12, px_per_mm=8.0))
    tracks.save(tmp_path / "tracks.npz")
    again = Tracks.load(tmp_path / "tracks.npz")
    calibration = known(tracks.reference_px, px_per_mm=8.0)
    gathered = Tracks.of(tracks.frames(), calibration)
    for name in ("t_us", "detected_px", "displacement_px", "coasted", "confidence", "reference_px"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tracks, name))
        np.testing.assert_array_equal(getattr(gathered, name), getattr(tracks, name))
    np.testing.assert_array_equal(again.force_n, tracks.force_n)
    assert again.meta == tracks.meta
    assert gathered.px_per_mm == 8.0
    assert Tracks.of([], calibration).displacement_px.shape == (0, 64, 2)


def test_the_table_is_that_of_the_csv_and_parquet_files(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="the extra [tables] is not installed")
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [parquet] is not installed")
    tracks = circling_tracks(estimates=5)
    for one, columns in ((tracks, []), (felt(tracks), ["force_x_n", "force_y_n", "force_z_n"])):
        table = one.to_pandas()
        assert tuple(table.columns)[:10] == CSV_COLUMNS
        assert list(table.columns)[10:13] == columns
        one.save(tmp_path / "tracks.csv")
        rows = list(csv.DictReader((tmp_path / "tracks.csv").read_text().splitlines()))
        in_file = pandas.DataFrame(rows).astype(float)
        assert list(in_file.columns) == list(table.columns)
        np.testing.assert_allclose(table.to_numpy(float), in_file.to_numpy(), atol=6e-4)
        assert json.loads((tmp_path / "tracks.csv.json").read_text()) == tracks.meta
        one.save(tmp_path / "tracks.parquet")
        meta = pq.read_metadata(tmp_path / "tracks.parquet").metadata[b"spikingtac"]
        assert json.loads(meta) == tracks.meta
        typed = pq.read_table(tmp_path / "tracks.parquet")
        pandas.testing.assert_frame_equal(typed.to_pandas(), table, check_dtype=False)
    circling_tracks(estimates=0).save(tmp_path / "none.parquet")
    assert pq.read_table(tmp_path / "none.parquet").num_rows == 0
    in_mm = circling_tracks(estimates=5, px_per_mm=15.5).to_pandas()
    assert {"displacement_x_mm", "displacement_y_mm"} <= set(in_mm.columns)
    smoothed = replace(tracks, sigma_px=tracks.detected_px).to_pandas()
    assert smoothed["sigma_x_px"].equals(smoothed["detected_x_px"])


def test_triggers_mark_the_row_after_them(tmp_path: Path) -> None:
    """Across chunks, too; those after the last estimate mark no row, but stay in the archive."""
    pytest.importorskip("pandas", reason="the extra [tables] is not installed")
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [parquet] is not installed")
    tracks = circling_tracks(estimates=FRAMES_PER_CHUNK + 2)
    after_us = int(tracks.t_us[FRAMES_PER_CHUNK])
    edges = {
        "trigger_t_us": np.array([tracks.t_us[3], after_us - 5, after_us - 1, 10**9]),
        "trigger_channel": np.array([0, 1, 6, 7], np.uint8),
        "trigger_edge": np.array([True, False, True, True]),
    }
    replace(tracks, **edges).save(tmp_path / "t.npz")
    marked = Tracks.load(tmp_path / "t.npz")
    for name, values in edges.items():
        np.testing.assert_array_equal(getattr(marked, name), values)
    expected: list[int | None] = [None] * len(tracks.t_us)
    expected[3], expected[FRAMES_PER_CHUNK] = 0, 6
    for ending in ("csv", "parquet"):
        marked.save(tmp_path / f"t.{ending}")
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    in_csv = [row["trigger"] for row in rows[::64]]
    assert in_csv == ["" if channel is None else str(channel) for channel in expected]
    assert pq.read_table(tmp_path / "t.parquet")["trigger"].to_pylist()[63::64] == expected
    in_pandas = marked.to_pandas()["trigger"][::64]
    assert [None if np.isnan(v) else v for v in in_pandas] == expected
    assert "trigger" not in tracks.to_pandas().columns
    replace(tracks, **edges | {"trigger_edge": np.ones(2, bool)}).save(tmp_path / "odd.npz")
    with pytest.raises(RecordingError, match="trigger_edge is bool of shape"):
        Tracks.load(tmp_path / "odd.npz")


def test_a_shift_is_a_difference_at_every_marker_and_time() -> None:
    found = compare_tracks(circling_tracks(), circling_tracks(off_px=0.25))
    assert found.distance_px.shape == (500, 64)
    np.testing.assert_allclose(found.distance_px, 0.25, atol=1e-4)
    summary = found.summary()
    for name in ("mean", "p50", "p95", "max"):
        assert summary[f"difference_{name}_px"] == pytest.approx(0.25, abs=1e-4)
    assert summary["difference_mean_mm"] is None
    assert not [name for name in (*summary, *found.by_marker()[0]) if "error" in name]


def test_a_truth_at_other_times_is_interpolated() -> None:
    tracks = circling_tracks(px_per_mm=10.0)
    times_us = np.arange(0, 400_001, 2_000)
    found = compare_with_truth(
        tracks, times_us, np.stack([positions_px(t_us) for t_us in times_us])
    )
    assert found.t_us[-1] <= 400_000 < found.t_us[-1] + 1_000
    # A chord of 2 ms of a circle of 6 px and 1 s leaves it by 6 (2 pi)^2 2e-3^2 / 8 px.
    assert found.distance_px.max() < 2e-4
    assert found.summary()["error_mean_mm"] == pytest.approx(found.distance_px.mean() / 10.0)
    alone = compare_with_truth(tracks, tracks.t_us[5:6], tracks.detected_px[5:6])
    assert (alone.t_us.tolist(), alone.distance_px.max()) == ([tracks.t_us[5]], 0.0)
    hidden = tracks.detected_px.copy()
    hidden[7, 3, 1] = np.nan
    with pytest.raises(
        ConfigError, match=f"marker 3 has no finite position at {tracks.t_us[7]} us"
    ):
        compare_with_truth(tracks, tracks.t_us, hidden)
