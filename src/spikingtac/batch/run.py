"""Work on many recordings: each failure is a row of the table, and a run can be resumed."""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Future, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.atomic_files import replacing
from spikingtac.batch.inputs import common_parent, identity, outputs_of
from spikingtac.batch.run_folder import RUN, begin_run
from spikingtac.batch.worker_pool import worker_pool
from spikingtac.errors import ConfigError, DeviceError, SpikingTacError

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
    """

    name: str
    work: Work
    recordings: Sequence[Path]
    folder: Path
    ending: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class Workers:
    """Who does the work.

    Attributes:
        count: Number of processes; None takes one for every CPU.
        scheduler: Address of a Dask scheduler in their place.
    """

    count: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchResult:
    """What became of a batch.

    Attributes:
        rows: One for each recording, failures first.
        kept: Number of results that were there already.
        table: The table of all results, in the order of the recordings.
    """

    rows: Sequence[Row]
    kept: int
    table: Path

    @property
    def failed(self) -> int:
        """Number of recordings that failed."""
        return sum(row["status"] == "failed" for row in self.rows)


@dataclass(frozen=True, slots=True)
class _Job:
    key: str
    source: Path
    output: Path


def run_batch(
    batch: Batch,
    workers: Workers,
    resume: bool = False,
    overwrite: bool = False,
    advance: Callable[[float], None] = lambda share: None,
) -> BatchResult:
    """Work on every recording of a batch that is not done yet.

    Args:
        batch: The work.
        workers: Who does it.
        resume: Go on with the run in the folder: keep what is done, try again what failed.
        overwrite: Remove the run in the folder first.
        advance: Told the share that is done, 0 to 1.

    Raises:
        ConfigError: The folder holds something else, or a run with other settings, or of recordings
            below another folder.
        DeviceError: The cluster cannot be reached, or was lost.
    """
    jobs = _jobs(batch)
    # The pool comes first: a cluster that does not answer leaves no run to be resumed.
    with worker_pool(workers.count, len(jobs), workers.scheduler, isolated=True) as pool:
        begin_run(batch.folder, _settings(batch), resume, overwrite)
        journal = batch.folder / JOURNAL
        found = _done(journal, jobs)
        kept = len(found)
        futures = {
            pool.submit(_work_on, batch.work, job): job for job in jobs if job.key not in found
        }
        with journal.open("a", encoding="utf-8", newline="\n") as file:
            for future in as_completed(futures):
                job = futures[future]
                found[job.key] = row = _row_of(future, job)
                size = job.output.stat().st_size if row["status"] == "done" else 0
                file.write(json.dumps({"key": job.key, "bytes": size, "row": row}) + "\n")
                file.flush()
                advance(len(found) / len(jobs))
    rows = [found[job.key] for job in jobs]
    table = _write_table(batch.folder / TABLE, rows)
    failures_first = sorted(rows, key=lambda row: row["status"] != "failed")
    return BatchResult(rows=failures_first, kept=kept, table=table)


def _work_on(work: Work, job: _Job) -> Row:
    """Do a job in a worker; whatever goes wrong with one recording is its row."""
    begun = time.perf_counter()
    try:
        job.output.parent.mkdir(parents=True, exist_ok=True)
        figures, error = work(job.source, job.output), None
    except Exception as problem:
        known = isinstance(problem, SpikingTacError | OSError)
        kind = "" if known else f"internal error, {type(problem).__name__}: "
        figures, error = {}, f"{kind}{problem}"
    return _row(job, time.perf_counter() - begun, error) | dict(figures)


def _row_of(future: Future[Row], job: _Job) -> Row:
    """Return what a worker found, or why there is none."""
    try:
        return future.result()
    except CancelledError as error:  # nobody here cancels: the cluster did
        raise DeviceError(
            "the Dask cluster was lost; what is done is kept, go on with --resume"
        ) from error
    except Exception as error:  # _work_on raises nothing: the worker is lost
        return _row(job, 0.0, f"{error}")


def _row(job: _Job, seconds: float, error: str | None) -> Row:
    return {
        "source": str(job.source),
        "output": None if error else str(job.output),
        "status": "failed" if error else "done",
        "error": error,
        "seconds": round(seconds, 6),
    }


def _jobs(batch: Batch) -> list[_Job]:
    """Return the jobs; the key of each is a digest of all that its result depends on."""
    folder, jobs = batch.folder.absolute(), []
    for recording, output in zip(
        batch.recordings, outputs_of(batch.recordings, folder, batch.ending), strict=True
    ):
        if output.parent == folder and output.name in (JOURNAL, RUN, TABLE):
            raise ConfigError(
                f"{str(recording)!r} would be written to {str(output)!r}, a file of the run "
                "itself; rename the recording"
            )
        files = identity(recording) if recording.exists() else []
        depends = (str(recording.absolute()), files, str(output), _settings(batch))
        key = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()
        jobs.append(_Job(key, recording.absolute(), output))
    return jobs


def _settings(batch: Batch) -> Row:
    """Return what all results depend on: files that the settings name count by their content."""
    named = {name: Path(value) for name, value in batch.settings.items() if isinstance(value, str)}
    digests = {
        f"{name}_sha256": hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in named.items()
        if path.is_absolute() and path.is_file()
    }
    below = str(common_parent(batch.recordings))  # another one would move the results
    version = package_version()
    return {"verb": batch.name, "version": version, "below": below, **batch.settings, **digests}


def _done(journal: Path, jobs: Sequence[_Job]) -> dict[str, Row]:
    """Return the rows of what is done and still there whole; a line that a crash cut is none."""
    lines = {}
    text = journal.read_text(encoding="utf-8", errors="replace") if journal.is_file() else ""
    if text and not text.endswith("\n"):
        with journal.open("a", encoding="utf-8") as file:
            file.write("\n")
    for line in text.splitlines():
        try:
            found = json.loads(line)
            lines[found["key"]] = found
        except (ValueError, KeyError, TypeError):
            continue
    return {
        job.key: found["row"]
        for job in jobs
        if (found := lines.get(job.key))
        and found["row"]["status"] == "done"
        and job.output.is_file()
        and job.output.stat().st_size == found["bytes"]
    }


def _write_table(path: Path, rows: Sequence[Row]) -> Path:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path
