"""Tracks as other libraries hold them, against the arrays themselves."""

from __future__ import annotations

import builtins
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import MissingExtraError
from spikingtac.plots.tracks import plot_tracks
from spikingtac.tracks import CSV_COLUMNS, Tracks
from spikingtac.tracks import parquet as parquet_module
from stand_ins.tracks import HELD_MARKER, circling_tracks


def test_axes_have_names_and_values_units() -> None:
    pytest.importorskip("xarray", reason="the extra [xarray] is not installed")
    tracks = circling_tracks(estimates=20, px_per_mm=8.0)
    data = tracks.to_xarray()
    assert dict(data.sizes) == {"t_us": 20, "marker": 64, "axis": 2}
    at = data.displacement_px.sel(marker=10, axis="y").sel(t_us=7_500, method="nearest")
    row = int(np.abs(tracks.t_us - 7_500).argmin())
    assert float(at) == tracks.displacement_px[row, 10, 1]
    assert data.displacement_px.attrs["units"] == "px"
    assert data.displacement_mm.attrs["units"] == "mm"
    assert "units" not in data.held.attrs
    np.testing.assert_array_equal(data.displacement_mm, tracks.displacement_px / 8.0)
    assert data.held.sel(marker=HELD_MARKER).all()
    assert (int(data.row[10]), int(data.column[10])) == (1, 2)
    assert json.loads(data.attrs["meta"]) == tracks.meta


def test_without_grid_scale_and_wrench_their_values_are_left_out() -> None:
    pytest.importorskip("xarray", reason="the extra [xarray] is not installed")
    data = replace(circling_tracks(estimates=3), meta={}).to_xarray()
    assert not {"row", "column"} & set(data.coords)
    assert not {"displacement_mm", "wrench_estimate"} & set(data.data_vars)


def felt(tracks: Tracks) -> Tracks:
    values = np.arange(6.0 * len(tracks.t_us), dtype=np.float32).reshape(-1, 6)
    distance = np.linspace(0, 2, len(tracks.t_us), dtype=np.float32)
    return replace(
        tracks, wrench_estimate=values, wrench_half_width=values / 10, wrench_distance=distance
    )


def test_wrenches_are_labelled_and_saved(tmp_path: Path) -> None:
    tracks = felt(circling_tracks(estimates=30))
    tracks.save(tmp_path / "felt.npz")
    again = Tracks.load(tmp_path / "felt.npz")
    for name in ("wrench_estimate", "wrench_half_width", "wrench_distance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tracks, name))
    pytest.importorskip("xarray", reason="the extra [xarray] is not installed")
    assert tracks.to_xarray().wrench_estimate.dims == ("t_us", "component")


@pytest.mark.parametrize("rows_per_group", [64 * 7, 1 << 20])
def test_parquet_holds_the_values_with_their_types(
    tmp_path: Path, rows_per_group: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [parquet] is not installed")
    monkeypatch.setattr(parquet_module, "ROWS_PER_GROUP", rows_per_group)
    tracks = circling_tracks(estimates=40)
    tracks.save(tmp_path / "tracks.parquet")
    file = pq.ParquetFile(tmp_path / "tracks.parquet")
    assert file.num_row_groups == (6 if rows_per_group < 1000 else 1)
    table = file.read()
    assert tuple(table.column_names) == CSV_COLUMNS
    y_px = table["displacement_y_px"].to_numpy().reshape(40, 64)
    np.testing.assert_array_equal(y_px, tracks.displacement_px[:, :, 1])
    np.testing.assert_array_equal(table["t_us"].to_numpy()[::64], tracks.t_us)
    assert table["marker"].to_pylist()[:66] == [*range(64), 0, 1]
    assert table["held"].to_pylist()[HELD_MARKER]
    assert json.loads(file.metadata.metadata[b"spikingtac"]) == tracks.meta


def test_parquet_is_far_smaller_than_csv(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra [parquet] is not installed")
    rng = np.random.default_rng(0)
    tracks = circling_tracks()
    noise = rng.normal(0, 0.02, tracks.position_px.shape).astype(np.float32)
    tracks = replace(tracks, detected_px=tracks.detected_px + noise)
    for ending in ("csv", "parquet"):
        tracks.save(tmp_path / f"t.{ending}")
    sizes = [(tmp_path / f"t.{ending}").stat().st_size for ending in ("csv", "parquet")]
    assert sizes[0] > 3 * sizes[1]


def test_an_empty_or_abandoned_table_is_whole_or_absent(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [parquet] is not installed")
    circling_tracks(estimates=0).save(tmp_path / "none.parquet")
    assert pq.read_table(tmp_path / "none.parquet").num_rows == 0
    writer = parquet_module.ParquetTracksWriter(tmp_path / "given_up.parquet")
    writer.write(next(circling_tracks(estimates=1).frames()))
    writer.abandon()
    assert [path.name for path in tmp_path.iterdir()] == ["none.parquet"]


@pytest.mark.parametrize(
    ("module", "extra", "call"),
    [
        ("xarray", "xarray", lambda tracks, folder: tracks.to_xarray()),
        ("pandas", "tables", lambda tracks, folder: tracks.to_pandas()),
        ("pyarrow", "parquet", lambda tracks, folder: tracks.save(folder / "x.parquet")),
    ],
)
def test_a_missing_library_is_named_with_its_extra(
    module: str, extra: str, call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.split(".")[0] == module:
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=rf"spikingtac\[{extra}\]"):
        call(circling_tracks(estimates=1), tmp_path)


def test_frames_are_gathered() -> None:
    tracks = circling_tracks(estimates=12, px_per_mm=8.0)
    calibration = Calibration(
        reference_px=tracks.reference_px.astype(float),
        radius_px=np.full(64, 7.0),
        grid=(8, 8),
        size=(320, 320),
        px_per_mm=8.0,
    )
    again = Tracks.of(tracks.frames(), calibration)
    for name in ("t_us", "detected_px", "displacement_px", "coasted", "confidence", "reference_px"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tracks, name))
    assert (again.px_per_mm, again.meta["grid"]) == (8.0, [8, 8])
    assert Tracks.of([], calibration).displacement_px.shape == (0, 64, 2)


def test_plot_is_the_figure_of_the_plots() -> None:
    tracks = circling_tracks(estimates=50)
    one, other = (
        tracks.plot("map", at_us=9_000, theme="dark"),
        plot_tracks(tracks, "map", at_us=9_000, theme="dark"),
    )
    assert one.axes[0].get_title() == other.axes[0].get_title()
    assert one.get_facecolor() == other.get_facecolor()
    np.testing.assert_array_equal(
        one.axes[0].collections[0].get_array(), other.axes[0].collections[0].get_array()
    )
