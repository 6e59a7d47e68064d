"""Many recordings: which are meant, where results go, what is done, kept, tried again, refused."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spikingtac.batch.inputs import find_recordings, is_many, outputs_of
from spikingtac.batch.run import JOURNAL, TABLE, Batch, run_batch
from spikingtac.errors import ConfigError, RecordingError

SEEN: list[str] = []


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A folder with recordings of every kind, and with files that are none."""
    (tmp_path / "press.2").mkdir()
    (tmp_path / "press.2" / "events.raw").write_bytes(b"x")
    np.savez(tmp_path / "press.2" / "truth.npz", marker_px=np.zeros(1))
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("x")
    (tmp_path / "later").mkdir()
    (tmp_path / "later" / "slide.raw").write_bytes(b"x")
    (tmp_path / "later" / ".slide.partial-1.raw").write_bytes(b"x")
    np.savez(tmp_path / "events.npz", t=np.zeros(1), x=np.zeros(1))
    np.savez(tmp_path / "tracks.npz", t_us=np.zeros(1), displacement_px=np.zeros(1))
    (tmp_path / "broken.npz").write_bytes(b"PK")
    (tmp_path / "table.csv").write_text("t,x\n")
    (tmp_path / "notes.md").write_text("x")
    return tmp_path


def names(found: list[Path], day: Path) -> list[str]:
    return [str(path.relative_to(day)) for path in found]


def test_a_folder_stands_for_the_recordings_in_it_and_below(day: Path) -> None:
    expected = ["bag", "broken.npz", "events.npz", "later/slide.raw", "press.2"]
    assert names(find_recordings([day]), day) == expected


def test_a_pattern_and_what_it_overlaps_are_taken_once_and_results_never(day: Path) -> None:
    found = find_recordings([day / "*" / "*.raw", day / "later", day / "table.csv"])
    assert names(found, day) == ["later/slide.raw", "press.2/events.raw", "table.csv"]
    assert names(find_recordings([day / "p*"]), day) == ["press.2"]
    assert "later/slide.raw" not in names(find_recordings([day], apart_from=day / "later"), day)
    with pytest.raises(ConfigError, match="lies in the folder for the results"):
        find_recordings([day / "later"], apart_from=day / "later")
    beside = day / "later" / ".." / "press.2"
    assert find_recordings([beside], apart_from=day / "later") == [beside]


@pytest.mark.parametrize("given", ["-", "udp:7777", "twin:demo"])
def test_live_sources_are_refused(given: str) -> None:
    with pytest.raises(ConfigError, match="live source"):
        find_recordings([Path("a.raw"), Path(given)])


def test_one_recording_is_not_many(day: Path) -> None:
    one = (day / "press.2", day / "events.npz", day / "bag", day / "gone.raw", Path("udp:7777"))
    assert not any(is_many([path]) for path in one)
    assert is_many([day])
    assert is_many([day / "*.raw"])
    assert is_many([day / "a.raw", day / "b.raw"])


def test_results_lie_as_their_recordings_do_and_no_two_share_one(day: Path) -> None:
    outputs = outputs_of([day / "press.2", day / "later" / "slide.raw"], Path("/out"), ".npz")
    assert outputs == [Path("/out/press.2.npz"), Path("/out/later/slide.npz")]
    back = day / "later" / ".." / "press.2"
    assert outputs_of([back, day / "later" / "slide.raw"], Path("/out"), ".npz") == outputs
    with pytest.raises(ConfigError, match="would both be written"):
        outputs_of([day / "a.raw", day / "a.es"], Path("/out"), ".npz")


def work(recording: Path, output: Path) -> dict[str, Any]:
    """Write ``done``, and fail on recordings named so."""
    SEEN.append(recording.stem)
    if recording.stem == "fail":
        raise RecordingError("no <good>")
    if recording.stem == "bug":
        raise KeyError("x")
    output.write_text("done")
    return {"touches": 1, "note": recording.stem}


@pytest.fixture
def batch(tmp_path: Path, jobs_here: None) -> Batch:
    SEEN.clear()
    recordings = [tmp_path / f"{name}.raw" for name in ("a", "b", "fail", "c", "bug")]
    for path in recordings:
        path.write_text("events")
    settings = {"rate_hz": None, "calibration": str(tmp_path / "a.raw")}
    places = {"recordings": recordings, "folder": tmp_path / "out", "ending": ".txt"}
    return Batch(name="touch", work=work, settings=settings, **places)


def test_failures_stop_nothing_and_come_first(batch: Batch) -> None:
    shares: list[float] = []
    rows, kept = run_batch(batch, advance=shares.append)
    assert [Path(row["source"]).stem for row in rows] == ["fail", "bug", "a", "b", "c"]
    assert kept == 0
    assert shares == pytest.approx([n / 5 for n in range(1, 6)])
    assert "internal error, KeyError" in rows[1]["error"]
    with (batch.folder / TABLE).open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["source"] for row in table] == [str(path) for path in batch.recordings]
    assert table[0]["touches"] == "1"
    failed = {"status": "failed", "error": "no <good>", "output": "", "touches": "", "note": ""}
    assert {name: table[2][name] for name in failed} == failed


def test_a_resumed_run_works_on_what_is_missing_or_failed_only(batch: Batch) -> None:
    run_batch(replace(batch, recordings=batch.recordings[:4]))
    (batch.folder / "a.txt").unlink()
    (batch.folder / "b.txt").write_text("cut short")
    SEEN.clear()
    rows, kept = run_batch(batch, resume=True)  # one recording is new
    assert sorted(SEEN) == ["a", "b", "bug", "fail"]
    assert (kept, len(rows)) == (1, 5)
    batch.recordings[3].write_text("other events")
    SEEN.clear()
    run_batch(batch, resume=True)
    assert sorted(SEEN) == ["bug", "c", "fail"]


def test_a_line_that_a_crash_cut_is_worked_on_again(batch: Batch) -> None:
    run_batch(batch)
    journal = batch.folder / JOURNAL
    lines = journal.read_text().splitlines(keepends=True)
    assert [name in line for name, line in zip("ab", lines, strict=False)] == [True, True]
    journal.write_text("".join(lines[1:-2]) + lines[-2][:20])  # without a's, c's is cut
    SEEN.clear()
    run_batch(batch, resume=True)
    assert sorted(SEEN) == ["a", "bug", "c", "fail"]
    SEEN.clear()
    run_batch(batch, resume=True)
    assert sorted(SEEN) == ["bug", "fail"]


def test_results_of_other_settings_or_files_are_never_mixed(batch: Batch) -> None:
    run_batch(batch)
    other = replace(batch, settings={**batch.settings, "rate_hz": 10.0})
    with pytest.raises(ConfigError, match="rate_hz"):
        run_batch(other, resume=True)
    batch.recordings[0].write_text("another calibration")
    with pytest.raises(ConfigError, match="calibration_sha256"):
        run_batch(batch, resume=True)
    batch.recordings[0].write_text("events")
    with pytest.raises(ConfigError, match="--resume"):
        run_batch(batch)
    above = batch.recordings[0].parent.with_name("elsewhere.raw")  # would move the results
    with pytest.raises(ConfigError, match="below"):
        run_batch(replace(batch, recordings=[*batch.recordings, above]), resume=True)
    assert run_batch(other, overwrite=True)[1] == 0
    (above.parent / "notes").mkdir()
    (above.parent / "notes" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not empty"):
        run_batch(replace(batch, folder=above.parent / "notes"), overwrite=True)
