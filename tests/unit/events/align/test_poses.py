"""A robot's log on a sensor's clock, whatever its own clock is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.events.align.poses import Poses, load_poses
from spikingtac.events.align.shared_motion import Course, through_motion
from spikingtac.events.clock import TimeMap

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


def test_an_unknown_clock_is_found_by_what_moves() -> None:
    rng = np.random.default_rng(3)
    grid_us = np.arange(0, 40_000_000, 8_000)  # a controller of 125 Hz
    speed = np.zeros(len(grid_us))
    for at_us, width_us in zip(rng.uniform(1e6, 39e6, 30), rng.uniform(6e4, 2e5, 30), strict=True):
        speed += rng.uniform(5, 60) * np.exp(-0.5 * ((grid_us - at_us) / width_us) ** 2)
    place = np.column_stack([np.cumsum(speed * 0.008), np.zeros((len(grid_us), 2))])
    poses = Poses(grid_us, place, ("x", "y", "z"))
    truth = TimeMap(base_us=2_345_678.0, drift_ppm=40.0)
    events_us = np.arange(2_345_678, 42_000_000, 1_000)
    rate = np.interp(truth.inverse()(events_us), grid_us, speed)
    found = through_motion(
        poses.course(), Course(2_345_678, rng.poisson(2 + 3 * rate).astype(float))
    )
    middle = np.array([round(found.own_us)])
    assert abs(found(middle)[0] - truth(middle)[0]) < max(5.0 * found.error_us, 1_000.0)


def test_poses_that_rest_have_no_motion() -> None:
    still = Poses(np.array([0, 10**6]), np.ones((2, 3)), ("x", "y", "z"))
    with pytest.raises(RecordingError, match="hardly move"):
        still.course()
    with pytest.raises(RecordingError, match="first three columns"):
        Poses(np.array([0, 10**6]), np.ones((2, 1)), ("x",)).course()
