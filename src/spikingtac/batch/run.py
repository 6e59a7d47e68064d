"""Work on many recordings: each failure is a row of the table, and a run can be resumed."""

import csv
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from spikingtac._version import package_version
from spikingtac.atomic_files import replacing, write_json
from spikingtac.batch.inputs import common_parent, outputs_of
from spikingtac.batch.worker_pool import worker_pool
from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.file_kinds import digest_of

RUN = "run.json"  # The settings that the folder of a run was begun with.
JOURNAL = "journal.jsonl"  # File of a run with one line for each recording, written when it ends.
TABLE = "results.csv"  # File of a run with one row for each recording, written at its end.

# ``source, output, status`` (done, failed), ``error, seconds``, and the figures of the work.
Row = dict[str, Any]

# Takes recording and output; writes the output and returns figures by name.
Work = Callable[[Path, Path], Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Batch:
    """One kind of work on many recordings.

    Attributes:
        name: The verb.
        work: A function that workers import by its name, or a partial one.
        recordings: What to work on.
        folder: Where the results go.
        ending: Ending of the results.
        settings: All that the results depend on, as JSON holds it.
        workers: Number of processes; None takes one for every CPU.
    """

    name: str
    work: Work
    recordings: Sequence[Path]
    folder: Path
    ending: str
    settings: Mapping[str, Any]
    workers: int | None = None


class _Job(NamedTuple):
    source: Path
    output: Path
    files: list[list[Any]]  # name, size and time of change (ns) of each file of the recording


def run_batch(
    batch: Batch,
    resume: bool = False,
    overwrite: bool = False,
    advance: Callable[[float], None] = lambda share: None,
) -> tuple[list[Row], int]:
    """Work on every recording of a batch that is not done yet.

    Args:
        batch: The work.
        resume: Go on with the run in the folder: keep what is done, try again what failed.
        overwrite: Remove the run in the folder first.
        advance: Told the share that is done, 0 to 1.

    Returns:
        One row for each recording, failures first, and how many results were there already.

    Raises:
        ConfigError: The folder holds something else, or a run with other settings, or of recordings
            below another folder.
    """
    jobs = _jobs(batch)
    begin_run(batch.folder, _settings(batch), resume, overwrite)
    journal = batch.folder / JOURNAL
    found = _done(journal, jobs)
    with (
        worker_pool(batch.workers, len(jobs), isolated=True) as pool,
        journal.open("a", encoding="utf-8", newline="\n") as file,
    ):
        left = [job for job in jobs if job.source not in found]
        futures = {pool.submit(_work_on, batch.work, job): job for job in left}
        for future in as_completed(futures):
            job, lost = futures[future], future.exception()  # _work_on raises nothing
            figures, error, seconds = ({}, str(lost), 0.0) if lost else future.result()
            found[job.source] = row = {
                "source": str(job.source),
                "output": None if error else str(job.output),
                "status": "failed" if error else "done",
                "error": error,
                "seconds": seconds,
                **figures,
            }
            size = 0 if error else job.output.stat().st_size
            file.write(json.dumps({"files": job.files, "bytes": size, "row": row}) + "\n")
            file.flush()
            advance(len(found) / len(jobs))
    rows = [found[job.source] for job in jobs]
    write_rows(batch.folder / TABLE, list({name: 0 for row in rows for name in row}), rows)
    return sorted(rows, key=lambda row: not row["error"]), len(jobs) - len(left)


def write_rows(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    """Write rows as CSV, whole or not at all; what is no UTF-8 in a name is escaped."""
    with (
        replacing(path) as partial,
        partial.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file,
    ):
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def begin_run(
    folder: Path, settings: Mapping[str, Any], resume: bool, overwrite: bool = False
) -> None:
    """Begin a run in a folder, or continue the one in it.

    Args:
        folder: Is created if it does not exist.
        settings: The settings of the run; a folder holds the results of one set of them.
        resume: Whether a run with the same settings may continue.
        overwrite: Whether a run that is there is removed; nothing else ever is.

    Raises:
        ConfigError: The folder holds something else, or results of other settings; names them.
    """
    if resume and overwrite:
        raise ConfigError("--resume goes on with a run, --overwrite removes it: give one of them")
    begun = folder / RUN
    if begun.is_file() and not overwrite:
        return _require_same(folder, settings, resume)
    if begun.is_file():
        # The settings go last, so that an interrupted removal is still known as a run.
        for path in sorted(folder.iterdir(), key=lambda path: path.name == RUN):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise ConfigError(
            f"{str(folder)!r} is not empty and holds no run; give a new or an empty folder"
        )
    write_json(begun, settings)


def _require_same(folder: Path, settings: Mapping[str, Any], resume: bool) -> None:
    stored = json.loads((folder / RUN).read_text(encoding="utf-8"))
    given = json.loads(json.dumps(settings))
    changed = [
        f"{key} {stored.get(key)!r} -> {given.get(key)!r}"
        for key in sorted({*stored, *given})
        if stored.get(key) != given.get(key)
    ]
    if changed:
        raise ConfigError(
            f"{str(folder)!r} holds results with other settings ({', '.join(changed)}); results "
            "are never mixed: give a new folder, the settings of the old one, or --overwrite"
        )
    if not resume:
        raise ConfigError(
            f"{str(folder)!r} holds a run with these settings; "
            "continue it with --resume, replace it with --overwrite, or give a new folder"
        )


def _work_on(work: Work, job: _Job) -> tuple[Row, str | None, float]:
    """Do a job in a worker; return its figures, what went wrong, and its time, s."""
    begun, figures, error = time.perf_counter(), Row(), None
    try:
        job.output.parent.mkdir(parents=True, exist_ok=True)
        figures = dict(work(job.source, job.output))
    except Exception as problem:  # one recording stops no other one
        known = isinstance(problem, SpikingTacError | OSError)
        error = f"{'' if known else f'internal error, {type(problem).__name__}: '}{problem}"
    return figures, error, round(time.perf_counter() - begun, 6)


def _jobs(batch: Batch) -> list[_Job]:
    folder, jobs = batch.folder.absolute(), []
    outputs = outputs_of(batch.recordings, folder, batch.ending)
    for recording, output in zip(batch.recordings, outputs, strict=True):
        if output.parent == folder and output.name in (JOURNAL, RUN, TABLE):
            raise ConfigError(
                f"{str(recording)!r} would be written to {str(output)!r}, a file of the run "
                "itself; rename the recording"
            )
        files = sorted(recording.iterdir()) if recording.is_dir() else [recording]
        state = [[f.name, f.stat().st_size, f.stat().st_mtime_ns] for f in files if f.exists()]
        jobs.append(_Job(recording.absolute(), output, state))
    return jobs


def _settings(batch: Batch) -> Row:
    """Return what all results depend on: files that the settings name count by their content."""
    named = {k: Path(text) for k, text in batch.settings.items() if isinstance(text, str)}
    digests = {
        f"{name}_sha256": digest_of(path)
        for name, path in named.items()
        if path.is_absolute() and path.is_file()
    }
    # Recordings below another folder would move the results.
    about = {"version": package_version(), "below": str(common_parent(batch.recordings))}
    return {"verb": batch.name, **about, **batch.settings, **digests}


def _done(journal: Path, jobs: Sequence[_Job]) -> dict[Path, Row]:
    """Return the rows of what is done and still there whole; a line that a crash cut is none."""
    lines: dict[str, dict[str, Any]] = {}
    text = journal.read_text(encoding="utf-8", errors="replace") if journal.is_file() else ""
    if text and not text.endswith("\n"):
        with journal.open("a", encoding="utf-8") as file:
            file.write("\n")
    for line in text.splitlines():
        with suppress(ValueError, KeyError, TypeError):
            found = json.loads(line)
            lines[found["row"]["source"]] = found
    done: dict[Path, Row] = {}
    for job in jobs:
        found = lines.get(str(job.source), {"row": {"output": None}})
        same = found["row"]["output"] == str(job.output) and found.get("files") == job.files
        if same and job.output.is_file() and job.output.stat().st_size == found["bytes"]:
            done[job.source] = found["row"]
    return done
