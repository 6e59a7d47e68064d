"""The benches: an interrupted one goes on, streams have their rate, every case has its figures."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spikingtac_paper.harness.report import Row
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.throughput import bench
from spikingtac_paper.throughput.stream import TARGET_HZ, bench_stream


def test_an_interrupted_bench_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[str] = []

    def stream(camera: str, *_: Any) -> SimpleNamespace:
        if measured == ["typical"] and not resumed:
            raise KeyboardInterrupt
        measured.append(camera)
        return SimpleNamespace(rate_hz=2e6, events=None)

    def rows(camera: str, *_: Any) -> Iterator[Row]:
        yield bench.METRICS["step_p50_us"].row("default", camera, 1.0, 1)

    monkeypatch.setattr(bench, "bench_stream", stream)
    monkeypatch.setattr(bench, "calibration_of", lambda *_: None)
    monkeypatch.setattr(bench, "decoder_rows", lambda *_: ())
    monkeypatch.setattr(bench, "_camera_rows", rows)
    folder, resumed = tmp_path / "bench", False
    with pytest.raises(KeyboardInterrupt):
        bench.run(RunOptions(output=folder))
    resumed = True
    assert bench.run(RunOptions(output=folder, resume=True))["rows"] == 2
    assert measured == ["typical", "noisy"], "nothing is measured twice"


def test_the_stream_has_two_million_events_a_second_and_its_truth() -> None:
    stream = bench_stream("typical", 0, 1)
    assert stream.rate_hz == pytest.approx(TARGET_HZ, rel=0.1)
    assert np.ptp(stream.truth.marker_px, axis=0).max() > 5.0
