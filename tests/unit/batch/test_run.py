"""A batch without workers: what is done, kept, tried again, written and refused."""

import csv
import importlib.util
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from spikingtac.batch.job import FileJob, Outcome, run_job, run_text, text_of
from spikingtac.batch.journal import JOURNAL
from spikingtac.batch.run import Batch, run_batch
from spikingtac.batch.table import write_table
from spikingtac.errors import ConfigError


class Fake:
    """Writes ``done`` into every output, and fails on recordings named so."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    def __call__(self, jobs: Sequence[FileJob]) -> Iterator[Outcome]:
        for job in reversed(jobs):
            name = Path(job.source).stem
            self.seen.append(name)
            if name.startswith("fail"):
                yield Outcome.failure(job, "no <good>", "RecordingError")
                continue
            Path(job.output).write_text("done")
            figures = {"touches": 9 if name == "odd" else 1, "note": name}
            yield Outcome(
                key=job.key,
                source=job.source,
                output=job.output,
                seconds=0.5,
                figures=figures,
                output_bytes=4,
            )


@pytest.fixture
def batch(tmp_path: Path) -> Batch:
    recordings = [tmp_path / f"{name}.raw" for name in ("a", "b", "c", "d", "odd", "fail")]
    for path in recordings:
        path.write_text("events")
    return Batch(
        name="touch",
        work="spikingtac.nothing:at_all",
        recordings=recordings,
        folder=tmp_path / "out",
        ending=".txt",
        settings={"rate_hz": None, "calibration": str(tmp_path / "a.raw")},
    )


def test_failures_come_first_then_outliers(batch: Batch) -> None:
    shares: list[float] = []
    result = run_batch(batch, Fake(), advance=shares.append)
    names = [Path(str(row["source"])).stem for row in result.rows]
    assert names == ["fail", "odd", "a", "b", "c", "d"]
    assert (result.failed, result.odd, result.kept) == (1, 1, 0)
    assert shares == pytest.approx([n / 6 for n in range(1, 7)])
    page = result.report.read_text()
    assert page.index("fail.raw") < page.index("odd.raw") < page.index("a.raw")
    assert "no &lt;good&gt;" in page
    assert "<script" not in page


def test_the_table_holds_every_recording_once_in_the_order_given(batch: Batch) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra [parquet] is not installed")
    rows = pq.read_table(run_batch(batch, Fake()).table).to_pylist()
    assert [row["source"] for row in rows] == [str(path) for path in batch.recordings]
    assert [row["status"] for row in rows] == ["done"] * 5 + ["failed"]
    assert rows[0]["touches"] == 1
    assert rows[-1] | {"seconds": 0} == {
        "source": str(batch.recordings[-1]),
        "output": None,
        "status": "failed",
        "error": "no <good>",
        "outliers": None,
        "seconds": 0,
        "touches": None,
        "note": None,
    }


def test_without_pyarrow_the_table_is_csv(
    batch: Batch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rows = run_batch(batch, Fake()).rows
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "pyarrow" else real(name)
    )
    (tmp_path / "results.parquet").write_text("of an earlier run")
    table = write_table(tmp_path, rows)
    with table.open(newline="") as file:
        found = list(csv.DictReader(file))
    assert table.name == "results.csv"
    assert not (tmp_path / "results.parquet").exists()
    assert [row["source"] for row in found] == [str(row["source"]) for row in rows]
    assert found[-1]["touches"] == "1"


def test_a_resumed_run_works_on_what_is_missing_or_failed_only(batch: Batch) -> None:
    run_batch(batch, Fake())
    (batch.folder / "a.txt").unlink()
    (batch.folder / "b.txt").write_text("cut")
    batch.recordings[2].write_text("other events")
    again = Fake()
    result = run_batch(batch, again, resume=True)
    assert sorted(again.seen) == ["a", "b", "c", "fail"]
    assert result.kept == 2
    assert len(result.rows) == 6


def test_recordings_may_be_added_to_a_run(batch: Batch) -> None:
    run_batch(replace(batch, recordings=batch.recordings[:3]), Fake())
    more = Fake()
    run_batch(batch, more, resume=True)
    assert sorted(more.seen) == ["d", "fail", "odd"]


def test_a_line_that_a_crash_cut_is_worked_on_again(batch: Batch) -> None:
    run_batch(batch, Fake())
    journal = batch.folder / JOURNAL
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[1:-1]) + lines[-1][:20])
    again = Fake()
    run_batch(batch, again, resume=True)
    assert sorted(again.seen) == ["a", "fail"]  # the last line was a's, the first one fail's
    last = Fake()
    run_batch(batch, last, resume=True)
    assert last.seen == ["fail"]


def test_results_of_other_settings_or_files_are_never_mixed(batch: Batch) -> None:
    run_batch(batch, Fake())
    other = replace(batch, settings={**batch.settings, "rate_hz": 10.0})
    with pytest.raises(ConfigError, match="rate_hz"):
        run_batch(other, Fake(), resume=True)
    batch.recordings[0].write_text("another calibration")
    with pytest.raises(ConfigError, match="calibration_sha256"):
        run_batch(batch, Fake(), resume=True)
    batch.recordings[0].write_text("events")
    with pytest.raises(ConfigError, match="--resume"):
        run_batch(batch, Fake())
    assert run_batch(other, Fake(), overwrite=True).kept == 0


def test_recordings_from_above_would_move_the_results_and_are_refused(batch: Batch) -> None:
    run_batch(batch, Fake())
    above = batch.recordings[0].parent.with_name("elsewhere.raw")
    with pytest.raises(ConfigError, match="below"):
        run_batch(replace(batch, recordings=[*batch.recordings, above]), Fake(), resume=True)


def test_a_recording_cannot_take_the_place_of_the_runs_own_files(batch: Batch) -> None:
    path = batch.recordings[0].with_name("results.raw")
    with pytest.raises(ConfigError, match="of the run itself"):
        run_batch(replace(batch, recordings=[path], ending=".csv"), Fake())
    assert not batch.folder.exists()


def job(tmp_path: Path, **changes: str) -> FileJob:
    given = FileJob(
        work="spikingtac.cli.files.convert:convert_one",
        source=str(tmp_path / "no.raw"),
        output=str(tmp_path / "x" / "y.npz"),
        settings={"strict": False},
        key="k",
    )
    return replace(given, **changes)


def test_what_goes_wrong_is_an_outcome(tmp_path: Path) -> None:
    outcome = Outcome.parse(run_text(text_of(job(tmp_path))))
    assert (outcome.failed, outcome.kind, outcome.key) == (True, "RecordingError", "k")
    assert "there is no file" in str(outcome.error)


def test_a_worker_of_another_version_or_foreign_work_is_refused(tmp_path: Path) -> None:
    old = run_job(job(tmp_path, version="0.0.1"))
    assert "install the same version" in str(old.error)
    assert "no work of this package" in str(run_job(job(tmp_path, work="os:system")).error)
    assert run_job(job(tmp_path, work="spikingtac.errors:gone")).kind == "AttributeError"


def test_an_outcome_survives_its_text() -> None:
    outcome = Outcome(key="k", source="a", output="b", seconds=0.1, figures={"n": 1, "t": None})
    assert Outcome.parse(outcome.text()) == outcome
    assert json.loads(outcome.text())["figures"] == {"n": 1, "t": None}
