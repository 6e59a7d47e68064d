"""A robot's log on a sensor's clock, whatever its own clock is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.events.clock import TimeMap
from spikingtac.events.manifest import load_poses

CLOCK = TimeMap.from_clock({
    "offset_s": 200.0, "drift_ppm": 50.0, "offset_error_us": 8.0, "drift_error_ppm": 0.5,
    "jitter_us": 20.0, "span_s": 60.0, "middle_us": 30e6,
})  # fmt: skip


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_table_is_read_in_any_unit_of_time_and_any_order_of_columns(tmp_path: Path) -> None:
    rows = "x_mm,t_s,grip\n1,0.5,0\n2,0.75,1\n"
    found = load_poses(written(tmp_path / "p.csv", rows))
    assert found.t_us.tolist() == [500_000, 750_000]
    assert found.names == ("x_mm", "grip")
    assert found.state.tolist() == [[1.0, 0.0], [2.0, 1.0]]
    found.save(tmp_path / "p.npz")
    arrays = np.load(tmp_path / "p.npz")
    assert arrays["t_us"].dtype == np.int64
    assert arrays["state"].shape == (2, 2)
    assert arrays["names"].tolist() == ["x_mm", "grip"]


@pytest.mark.parametrize(
    "text",
    ["", "x,y\n1,2\n", "t_s,t_us,x\n1,2,3\n", "t_s,x\n1,nan\n", "t_s,x\n2,1\n1,1\n", "t_s,x\n1\n"],
)
def test_what_is_no_table_of_poses_is_refused_with_what_it_needs(tmp_path: Path, text: str) -> None:
    with pytest.raises(RecordingError, match="one time column"):
        load_poses(written(tmp_path / "p.csv", text))


def test_host_times_become_sensor_times_also_as_the_time_of_day() -> None:
    sensor_us = np.array([0, 30_000_000, 60_000_000])
    host_s = np.array([CLOCK.host_s(float(t_us)) for t_us in sensor_us])
    found = CLOCK.inverse()(np.rint(host_s * 1e6).astype(np.int64))
    assert np.abs(found - sensor_us).max() <= 1
    assert CLOCK.inverse().error_us == 8.0
    told = CLOCK.clock_summary()
    assert (told["offset_s"], told["middle_us"]) == (pytest.approx(200.0, abs=1e-9), 30e6)
