"""From tracks to a figure, a comparison and a data set, by the command line."""

import json
import os
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from spikingtac.tracks import Tracks
from stand_ins.tracks import FIRST_US, circling_tracks
from stand_ins.verbs import Verbs
from stand_ins.viewer import positions_px


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    one = circling_tracks(px_per_mm=15.5)
    one.meta.update(input="events.raw", input_sha256=sha256(b"tracked").hexdigest())
    one.save(tmp_path / "one.npz")
    circling_tracks(off_px=0.5).save(tmp_path / "other.npz")
    times_us = np.arange(0, 500_001, 1_000)
    truth = np.stack([positions_px(t_us) for t_us in times_us])
    np.savez(tmp_path / "truth.npz", marker_t_us=times_us, marker_px=truth)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_plot_writes_a_figure(folder: Path, verbs: Verbs) -> None:
    for output in ("field.png", "field.svg", "field.pdf"):
        found = verbs.told("plot", "one.npz", "--kind", "field", "--at-s", 0.1, "-o", output)
        assert found["output"] == output
        assert found["displacement_max_mm"] > 0.5
        assert (folder / output).stat().st_size > 1_000
    for given, why in (
        (["-o", "field.pdf"], "--overwrite"),
        (["-o", "a.gif", "--at-s", "1"], "is for one moment"),
        (["--from-s", "1"], "is for an animation"),
        (["--kind", "rate"], "is not for tracks"),
    ):
        assert why in verbs.said("plot", "one.npz", *given, code=2)


def test_compare_gives_the_error_between_tracks_and_to_a_truth(folder: Path, verbs: Verbs) -> None:
    found = verbs.told("compare", "one.npz", "other.npz", "--plot", "c.png", "--table", "c.csv")
    assert found["difference_mean_px"] == pytest.approx(0.5, abs=1e-3)
    assert found["difference_mean_mm"] == pytest.approx(0.5 / 15.5, abs=1e-4)
    assert (folder / "c.png").is_file()
    assert len((folder / "c.csv").read_text().splitlines()) == 65
    for truth, content in (("truth.npz", b"tracked"), (".", b"another")):
        (folder / "events.raw").write_bytes(content)
        assert verbs.told("compare", "one.npz", truth)["error_mean_px"] < 1e-3
        assert ("of another recording" in verbs.err) == (content == b"another")
    assert "difference mean " in verbs.said("compare", "one.npz", "other.npz")


LENGTHS = (500, 301)
FPS = 40


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """Two recordings; the second one moved otherwise."""
    folder = tmp_path / "day"
    folder.mkdir()
    for number, length in enumerate(LENGTHS):
        tracks = circling_tracks(estimates=length, px_per_mm=8.0, off_px=float(number))
        tracks.save(folder / f"{number}.npz")
    return folder


def tracks_of(day: Path) -> list[Tracks]:
    return [Tracks.load(day / f"{number}.npz") for number in range(len(LENGTHS))]


def rows_at(tracks: Tracks, t_us: np.ndarray) -> np.ndarray:
    """Return the last row before each time, found one by one."""
    return np.array([max(np.flatnonzero(tracks.t_us <= t)) for t in t_us])


def export(day: Path, form: str, output: Path, *options: object) -> list[object]:
    return ["export", day, "--to", form, "-o", output, *options]


def test_a_lerobot_data_set_holds_the_tracks_at_its_frames(
    day: Path, tmp_path: Path, verbs: Verbs
) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [lerobot] is not installed")
    pandas = pytest.importorskip("pandas", reason="the extra [lerobot] is not installed")
    out = tmp_path / os.fsdecode(b"no UTF-8 \xff") / "set"
    said = verbs.told(*export(day, "lerobot", out, "--fps", FPS, "--task", "twist"))
    out = out.rename(tmp_path / "set")
    info = json.loads((out / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (said["total_episodes"], said["total_frames"]) == (2, 20 + 13)
    assert said["largest_age_ms"] < 1.0
    table = pq.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    assert table["index"].to_pylist() == list(range(33))
    assert table["frame_index"].to_pylist() == [*range(20), *range(13)]
    moved = np.array(table["observation.tactile.displacement"].to_pylist(), np.float32)
    seen = np.array(table["observation.tactile.seen"].to_pylist())
    for number, tracks in enumerate(tracks_of(day)):
        mine = np.array(table["episode_index"]) == number
        frame = np.array(table["frame_index"])[mine]
        rows = rows_at(tracks, FIRST_US + frame * 1_000_000 // FPS)
        expected = tracks.displacement_px[rows].reshape(len(rows), -1)
        np.testing.assert_array_equal(moved[mine], expected)
        np.testing.assert_array_equal(seen[mine] == 1, ~tracks.coasted[rows])
        stamps = np.array(table["timestamp"])[mine]
        np.testing.assert_allclose(stamps, frame / FPS, rtol=1e-6)
    told = json.loads((out / "meta" / "stats.json").read_text())["observation.tactile.displacement"]
    np.testing.assert_allclose(told["mean"], moved.astype(float).mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(told["std"], moved.astype(float).std(axis=0), atol=1e-9)
    assert told["count"] == [33]
    tasks = pandas.read_parquet(out / "meta" / "tasks.parquet")
    assert tasks.loc["twist", "task_index"] == 0
    episodes = pq.read_table(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes["dataset_from_index"].to_pylist() == [0, 20]
    assert episodes["dataset_to_index"].to_pylist() == [20, 33]
    assert pq.ParquetFile(out / "data" / "chunk-000" / "file-000.parquet").num_row_groups == 2


def test_a_robots_log_is_aligned_in_time_and_never_from_the_future(
    day: Path, tmp_path: Path, verbs: Verbs
) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [lerobot] is not installed")
    pytest.importorskip("pandas", reason="the extra [lerobot] is not installed")
    logs = []
    for number, length in enumerate(LENGTHS):
        t_us = np.arange(20_000, length * 1_000, 8_000)
        state = np.column_stack((t_us, -t_us, t_us * 0 + number)).astype(np.float32)
        logs.append(tmp_path / f"log{number}.npz")
        np.savez(logs[-1], t_us=t_us, state=state, action=state[:, :1])
    out = tmp_path / "set"
    said = verbs.told(*export(day, "lerobot", out, "--fps", 100, "--log", *logs))
    assert said["largest_age_ms"] < 8.0
    table = pq.read_table(out / "data" / "chunk-000" / "file-000.parquet")
    state = np.array(table["observation.state"].to_pylist())
    age_us = 20_000 + np.array(table["frame_index"]) * 10_000 - state[:, 0]
    assert age_us.min() >= 0
    assert age_us.max() < 8_000
    assert (state[:, 2] == np.array(table["episode_index"])).all()
    assert table["action"].to_pylist() == state[:, 0].tolist()  # one number is no list
    bad = np.where(t_us[:, None] == 100_000, np.nan, t_us[:, None])
    np.savez(logs[-1], t_us=t_us, state=bad, action=bad)
    said_why = verbs.said(
        *export(day, "lerobot", out, "--fps", 125, "--overwrite", "--log", *logs), code=1
    )
    assert "observation.state, column 0, is nan at 100000 us" in said_why


def test_a_zarr_store_holds_the_tracks(day: Path, tmp_path: Path, verbs: Verbs) -> None:
    zarr = pytest.importorskip("zarr", reason="the extra [zarr] is not installed")
    out = tmp_path / "set.zarr"
    said = verbs.told(*export(day, "zarr", out))
    assert (said["recordings"], said["frames"]) == (2, sum(LENGTHS))
    root = zarr.open_group(str(out), mode="r")
    assert sorted(root) == ["0", "1"]
    for number, tracks in enumerate(tracks_of(day)):
        group = root[str(number)]
        np.testing.assert_array_equal(group["t_us"][:], tracks.t_us)
        np.testing.assert_array_equal(group["displacement_px"][:], tracks.displacement_px)
        np.testing.assert_array_equal(group["held"][:], tracks.coasted)
        assert group.attrs["px_per_mm"] == 8.0
        assert "force_n" not in group


def test_a_data_set_is_replaced_only_when_asked_and_nothing_else_ever_is(
    day: Path, tmp_path: Path, verbs: Verbs
) -> None:
    pytest.importorskip("zarr", reason="the extra [zarr] is not installed")
    out = tmp_path / "set"
    verbs.said(*export(day, "zarr", out))
    assert "--overwrite" in verbs.said(*export(day, "zarr", out), code=2)
    (day / "1.npz").write_bytes(b"PK broken")
    before = sorted(path.name for path in out.iterdir())
    verbs.said(*export(day, "zarr", out, "--overwrite"), code=1)
    assert sorted(path.name for path in out.iterdir()) == before
    (day / "1.npz").unlink()
    verbs.said(*export(day, "zarr", out, "--overwrite"))
    assert not (out / "1").exists()
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine")
    verbs.said(*export(day, "zarr", other, "--overwrite"), code=2)
    assert (other / "thesis.txt").read_text() == "mine"
    assert not list(tmp_path.glob(".*"))
