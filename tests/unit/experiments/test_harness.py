"""Rows, report, kept records and the folder of a run; the benches."""

import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spikingtac.types import EventPacket
from spikingtac_paper.harness.report import Metric, Report, Row, interval, rows_of, write_report
from spikingtac_paper.harness.run import Progress, RunOptions, kept, load_windows, save_windows
from spikingtac_paper.point_tracking.experiment import PUBLISHED
from spikingtac_paper.throughput import bench
from spikingtac_paper.throughput.stream import TARGET_HZ, bench_stream
from stand_ins.random_packets import assert_equal, random_packet

METRICS = (
    Metric("return_mean_px", "px", "how far"),
    Metric("lost_markers", "markers", "how many", "sum"),
)


def record(scene: str, seed: int, far: float, lost: float = 0.0) -> dict:
    return {
        "method": "evetac",
        "trial": {"case": scene, "groups": ["all"], "seed": seed, "source": "twin"},
        "scores": {"return_mean_px": far, "lost_markers": lost},
    }


RECORDS = [record("a", 0, 1.0, 2.0), record("b", 0, 3.0), record("a", 1, 2.0, 1.0),
           record("b", 1, 4.0)]  # fmt: skip


def test_rows_join_trials_and_name_the_papers_number_in_its_case_only() -> None:
    rows = {(r.case, r.metric): r for r in rows_of(RECORDS, METRICS, PUBLISHED, "all")}
    assert rows["all", "return_mean_px"].value == 2.5
    assert rows["all", "return_mean_px"].n == 4
    assert rows["all", "return_mean_px"].paper == 1.6276
    assert rows["a", "return_mean_px"].paper is None
    assert rows["all", "lost_markers"].value == 3.0
    low, high = rows["all", "return_mean_px"].ci95 or (0.0, 0.0)
    assert (low + high) / 2 == pytest.approx(2.5)
    # Seeds give 2 and 3: Student's t for one degree of freedom is 12.706, over sqrt(2) * std.
    assert (high - low) / 2 == pytest.approx(12.7062 * np.sqrt(0.5) / np.sqrt(2.0), rel=1e-4)
    assert interval(np.array([1.0])) is None


def test_report_files(tmp_path: Path) -> None:
    rows = rows_of(RECORDS, METRICS, PUBLISHED, "all")
    report = Report(title="Point <tracking>", settings={"experiment": "point-tracking"}, rows=rows,
                    first=["all"], findings=["one & two"],
                    figures=[("a figure", "<?xml version='1.0'?><svg></svg>")])  # fmt: skip
    assert write_report(report, RunOptions(output=tmp_path), trials=4)["trials"] == 4
    document = json.loads((tmp_path / "report.json").read_text())
    keys = {"method", "case", "metric", "value", "unit", "n", "source", "paper", "definition"}
    assert all(keys <= set(row) for row in document["rows"])
    page = (tmp_path / "report.html").read_text()
    assert "one &amp; two" in page
    assert "Point &lt;tracking&gt;" in page
    assert "simulated (twin)" in page
    assert page.index("<h2>all</h2>") < page.index("<details>") < page.index("<h2>a</h2>")
    assert "2.500 <span class='paper'>1.628</span>" in page, "side by side, never merged"
    assert "src=" not in page
    assert "http" not in page
    assert len((tmp_path / "tables" / "rows.csv").read_text().splitlines()) == len(rows) + 1


def test_a_record_is_made_once_for_a_key_and_again_where_it_is_damaged(tmp_path: Path) -> None:
    values, path = count(1), tmp_path / "record.json"

    def make() -> dict:
        return {"value": next(values)}

    assert kept(path, "a", make) == kept(path, "a", make) == {"key": "a", "value": 1}
    assert kept(path, "b", make)["value"] == 2
    path.write_bytes(b'{"key": "b", "val')
    assert kept(path, "b", make)["value"] == 3


def test_jobs_come_back_in_order_and_are_counted() -> None:
    shares: list[float] = []
    options = RunOptions(output=Path(), workers=1, advance=shares.append)
    progress = Progress(options, 4)
    with options.pool(4) as pool:
        assert progress.run(pool, abs, [-3, 2]) == [3, 2]
        assert progress.run(pool, abs, [-1]) == [1]
        with pytest.raises(TypeError):
            progress.run(pool, abs, ["x"])
    assert shares == [0.25, 0.5, 0.75]


def test_windows_come_back_as_they_were_the_empty_ones_too(tmp_path: Path) -> None:
    full = random_packet(1, 200, (320, 320))
    windows = [(full,), (EventPacket.empty(full.t_end_us, full.t_end_us + 9, full.size),)]
    save_windows(tmp_path / "quiet.npz", windows)
    for (was,), (now,) in zip(windows, load_windows(tmp_path / "quiet.npz"), strict=True):
        assert (was.t_start_us, was.t_end_us, was.size) == (now.t_start_us, now.t_end_us, now.size)
        assert_equal(now, was)


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
