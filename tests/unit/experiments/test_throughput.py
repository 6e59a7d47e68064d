"""The benches: an interrupted one goes on, streams have their rate, every case has its figures."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spikingtac_paper.harness.report import Row
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.throughput import bench, skins
from spikingtac_paper.throughput.skins import Skin, skin_stream
from spikingtac_paper.throughput.stream import TARGET_HZ, bench_stream

SMALL = Skin((2, 3), (120, 90), 15.5, 0.45)


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


def test_a_skin_has_its_rate_and_every_case_its_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert skin_stream(SMALL, 0.3, 0, 60_000).rate_hz == pytest.approx(0.3e6, rel=0.25)
    monkeypatch.setattr(skins, "SKINS", (SMALL,))
    monkeypatch.setattr(skins, "RATES_MEV_S", (0.3,))
    monkeypatch.setattr(skins, "QUICK_DURATION_US", 40_000)
    skins.run(RunOptions(output=tmp_path / "bench", quick=True))
    rows = json.loads((tmp_path / "bench" / "report.json").read_text())["rows"]
    assert {row["case"] for row in rows} == {"6@0.3"}
    steps = {(method, metric) for method in skins.METHODS for metric in skins.METRICS}
    assert {(row["method"], row["metric"]) for row in rows} == steps
    assert all(row["value"] > 0.0 for row in rows)
    errors = [row["value"] for row in rows if row["metric"] == "error_mean_px"]
    assert max(errors) < 0.5, "the markers are followed"
