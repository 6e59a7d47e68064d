"""Work on many recordings: resume what was begun, write table and report, stop at no failure."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.batch.inputs import common_parent, identity, outputs_of
from spikingtac.batch.job import Figure, FileJob, Outcome
from spikingtac.batch.journal import JOURNAL, Journal
from spikingtac.batch.outliers import unlike
from spikingtac.batch.report import REPORT, ordered, write_report
from spikingtac.batch.run_folder import RUN, begin_run, forget_run
from spikingtac.batch.table import NAME, rows_of, write_table
from spikingtac.errors import ConfigError, SpikingTacError

Runner = Callable[[Iterable[FileJob]], Iterator[Outcome]]
"""Yields the outcome of every job as they come: worker processes, or a cluster."""

RESERVED = (JOURNAL, REPORT, RUN, f"{NAME}.csv", f"{NAME}.parquet")
"""Files of the run itself, beside the results."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Batch:
    """One kind of work on many recordings.

    Attributes:
        name: The verb.
        work: ``module:function``, see :class:`spikingtac.batch.job.FileJob`.
        recordings: What to work on.
        folder: Where the results go.
        ending: Ending of the results.
        settings: What the work needs to know, as JSON holds it; the same for all.
    """

    name: str
    work: str
    recordings: Sequence[Path]
    folder: Path
    ending: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchResult:
    """What became of a batch.

    Attributes:
        rows: One for each recording: failures first, then outliers, then the others.
        kept: Number of results that were there already.
        table: The table of all results.
        report: The page about them.
    """

    rows: Sequence[Mapping[str, Figure]]
    kept: int
    table: Path
    report: Path

    @property
    def failed(self) -> int:
        """Number of recordings that failed."""
        return sum(row["status"] == "failed" for row in self.rows)

    @property
    def odd(self) -> int:
        """Number of recordings that are unlike the others."""
        return sum(row["outliers"] is not None for row in self.rows)


def run_batch(
    batch: Batch,
    runner: Runner,
    resume: bool = False,
    overwrite: bool = False,
    advance: Callable[[float], None] = lambda share: None,
) -> BatchResult:
    """Work on every recording of a batch that is not done yet.

    Args:
        batch: The work.
        runner: Who does it.
        resume: Go on with the run in the folder: keep what is done, try again what failed.
        overwrite: Remove the run in the folder first.
        advance: Told the share that is done, 0 to 1.

    Raises:
        ConfigError: The folder holds something else, or a run with other settings, or of recordings
            below another folder.
    """
    jobs = _jobs(batch)
    settings = {
        "verb": batch.name,
        "version": package_version(),
        "below": str(common_parent(batch.recordings)),  # another one would move the results
        **batch.settings,
    }
    new = begin_run(batch.folder, settings | _digests(batch.settings), resume, overwrite)
    with Journal(batch.folder) as journal:
        found = {job.key: outcome for job in jobs if (outcome := journal.done(job))}
        kept, todo = len(found), [job for job in jobs if job.key not in found]
        try:
            for outcome in runner(todo) if todo else ():
                found[outcome.key] = outcome
                journal.add(outcome)
                advance(len(found) / len(jobs))
        except SpikingTacError:
            if new and not found:  # no worker was reached: nothing is to be resumed
                forget_run(batch.folder)
            raise
    outcomes = [found[job.key] for job in jobs]
    rows = rows_of(outcomes, unlike([outcome.figures for outcome in outcomes]))
    title = f"spikingtac {batch.name}"
    return BatchResult(
        rows=ordered(rows),
        kept=kept,
        table=write_table(batch.folder, rows),
        report=write_report(batch.folder, title, rows),
    )


def _jobs(batch: Batch) -> list[FileJob]:
    outputs = outputs_of(batch.recordings, batch.folder.absolute(), batch.ending)
    jobs = []
    for recording, output in zip(batch.recordings, outputs, strict=True):
        if output.parent == batch.folder.absolute() and output.name in RESERVED:
            raise ConfigError(
                f"{str(recording)!r} would be written to {str(output)!r}, a file of the run "
                "itself; rename the recording"
            )
        source = str(recording.absolute())
        files = identity(recording) if recording.exists() else []
        depends = (batch.work, source, files, str(output), batch.settings, package_version())
        key = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()
        jobs.append(
            FileJob(
                work=batch.work,
                source=source,
                output=str(output),
                settings=batch.settings,
                key=key,
            )
        )
    return jobs


def _digests(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the sha256 of every file that the settings name: results depend on its content."""
    named = {name: Path(value) for name, value in settings.items() if isinstance(value, str)}
    return {
        f"{name}_sha256": hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in named.items()
        if path.is_absolute() and path.is_file()
    }
