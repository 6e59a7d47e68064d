"""The throughput bench: what an interrupted one keeps, and what its sentences say."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.throughput import bench as module
from spikingtac_paper.throughput.bench import CAMERAS, run

VALUES = {
    "default": {"step_p50_us": 200.0, "step_p99_us": 400.0, "error_mean_px": 0.1},
    "opencv_tuned": {"step_p50_us": 300.0, "step_p99_us": 500.0, "error_mean_px": 1.0},
}


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stand in for the measurements; returns the cameras that were measured."""
    cameras: list[str] = []

    def rows(stream: Any, calibration: Any, options: RunOptions) -> Iterator[Row]:
        if options.seed and cameras:
            raise KeyboardInterrupt
        cameras.append(stream.camera)
        for method, values in VALUES.items():
            for metric, value in {**values, "speedup_vs_opencv_tuned": 3.0}.items():
                yield module._row(method, stream.camera, metric, value, 10)

    monkeypatch.setattr(
        module,
        "kept_stream",
        lambda camera, *_: SimpleNamespace(camera=camera, rate_hz=2e6, trial=None, events=None),
    )
    monkeypatch.setattr(module, "calibration_of", lambda *_: None)
    monkeypatch.setattr(module, "decoder_rows", lambda *_: ())
    monkeypatch.setattr(module, "_camera_rows", rows)
    return cameras


def test_an_interrupted_bench_goes_on_where_it_was(tmp_path: Path, measured: list[str]) -> None:
    folder = tmp_path / "bench"
    with pytest.raises(KeyboardInterrupt):
        run(RunOptions(output=folder, seed=1))
    assert measured == ["typical"]
    measured.clear()
    assert run(RunOptions(output=folder, seed=1, resume=True))["rows"] == 2 * 2 * 4
    assert measured == ["noisy"], "nothing is measured twice"


def test_the_sentences_name_error_and_speed_beside_the_tuned_peer(
    tmp_path: Path, measured: list[str]
) -> None:
    told = run(RunOptions(output=tmp_path / "bench"))["findings"]
    assert len(told) == len(CAMERAS)
    assert told[0].startswith("default on typical: 200 us a step at the median, 400 us")
    assert "3.0 times as fast as tuned OpenCV" in told[0]
    assert "at 0.10 of its error (0.100 px)" in told[0]
