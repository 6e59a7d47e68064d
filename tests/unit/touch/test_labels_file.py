"""Forces from files of their own: the twin's truth, and a force sensor on another clock."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import RecordingError
from spikingtac.touch.force.series import WrenchSeries, labelled

REFERENCE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


def pressing(t_s: np.ndarray) -> np.ndarray:
    """Three presses at odd moments."""
    moments = ((1.0, 0.5), (2.7, 0.9), (5.1, 0.3))
    return sum((np.exp(-(((t_s - at) / width) ** 2)) for at, width in moments), 0.0 * t_s)


def watched() -> WrenchSeries:
    t_us = np.arange(0, 7_000_000, 10_000, dtype=np.int64)
    moved = np.ones((len(t_us), 4, 2)) * 0.4 * pressing(t_us / 1e6)[:, None, None]
    return WrenchSeries(t_us, REFERENCE, moved, np.empty((len(t_us), 0)), "mm", "watched")


def test_a_force_sensor_on_another_clock_is_aligned(tmp_path: Path) -> None:
    path, offset_s = tmp_path / "force.csv", 1234.5678
    t_s = np.arange(-0.5, 7.5, 0.002)
    lines = [
        f"{t + offset_s:.6f},0.0,0.1,{-5 * p:.5f}" for t, p in zip(t_s, pressing(t_s), strict=True)
    ]
    path.write_text("t_s,Fx,Fy,Fz\n" + "\n".join(lines) + "\n")
    series = labelled(watched(), path)
    truth = -5 * pressing(series.t_us / 1e6)
    assert len(series.t_us) == len(watched().t_us)
    np.testing.assert_allclose(series.wrench[:, 2], truth, atol=0.05)


def test_forces_of_another_recording_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "force.csv"
    values = np.random.default_rng(0).normal(size=500)
    path.write_text(
        "t_us,fx,fy,fz\n" + "".join(f"{i * 10000},{v},0,0\n" for i, v in enumerate(values))
    )
    with pytest.raises(RecordingError, match="same recording"):
        labelled(watched(), path)


def test_the_truth_of_the_twin_needs_no_alignment(tmp_path: Path) -> None:
    t_us = np.array([1_000_000, 2_000_000, 3_000_000], np.int64)
    force = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 2.0], [0.0, 1.0, 3.0]])
    np.savez(tmp_path / "truth.npz", contact_t_us=t_us, force_n=force, torque_n_mm=1000 * force)
    series = labelled(watched(), tmp_path)
    assert series.t_us[0] == 1_000_000
    assert series.t_us[-1] == 3_000_000
    middle = np.searchsorted(series.t_us, 1_500_000)
    np.testing.assert_allclose(series.wrench[middle], [0.5, 0.0, 1.5] * 2)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "t_us,fx\n1,2\n",
        "t_us,fx,fy,fz\n1,a,2,3\n",
        "t_us,fx,fy,fz\n",
        "t_us,fx,fy,fz\n1,0,0,1\n2,0,nan,1\n",
        "t_us,fx,fy,fz,mz\n1,0,0,1,0\n",
    ],
)
def test_files_without_forces_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "force.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"force\.csv"):
        labelled(watched(), path)
    with pytest.raises(RecordingError, match="no forces"):
        labelled(watched(), tmp_path)


def test_a_truncated_truth_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth.npz"
    np.savez(path, contact_t_us=np.arange(100), force_n=np.zeros((100, 3)))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(RecordingError, match="no forces"):
        labelled(watched(), path)
