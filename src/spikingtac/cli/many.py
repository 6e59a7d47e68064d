"""The common part of verbs that take many recordings: options, workers, and the last words."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.batch.job import FileJob, Outcome
    from spikingtac.batch.run import Batch, BatchResult

SHOWN = 20
"""Failures and outliers that are printed; the report holds all."""


@dataclass(frozen=True, kw_only=True)
class ManyArgs:
    """Options of verbs that take many recordings."""

    workers: int | None = None
    """Many recordings: worker processes; one for every CPU unless given."""
    scheduler: str | None = None
    """Many recordings: a Dask scheduler, tcp://127.0.0.1:8786, or tls://HOST:8786 with --tls."""
    tls: Path | None = None
    """With tls://: folder with ca.pem, cert.pem and key.pem."""
    resume: bool = False
    """Many recordings: go on with the run in the folder."""
    overwrite: bool = False
    """Replace a file that is already there; of many recordings, the run in the folder."""
    json: bool = False
    """Print one JSON object on stdout."""


def means_many(args: ManyArgs, given: Sequence[Path]) -> bool:
    """Return whether a verb shall work on many recordings, into a folder.

    Raises:
        ConfigError: The options do not go together.
    """
    from spikingtac.batch.inputs import is_many

    if not given:
        raise ConfigError("name a recording, several, a folder of them, or a pattern in quotes")
    check_workers(args.workers, args.scheduler, args.tls)
    asked = args.workers is not None or args.scheduler is not None or args.resume
    return asked or is_many(given)


def check_workers(workers: int | None, scheduler: str | None, tls: Path | None) -> str | None:
    """Return the address of the cluster that is asked for, with its port; None for processes.

    Args:
        workers: Number of processes.
        scheduler: Address of a Dask scheduler.
        tls: Folder with certificates.

    Raises:
        ConfigError: They do not go together, or the address is not to be connected to.
    """
    if workers is not None and scheduler is not None:
        raise ConfigError("--workers are processes here, --scheduler has its own: give one of them")
    if workers is not None and workers < 1:
        raise ConfigError(f"--workers is {workers}, it must be at least 1")
    if tls is not None and scheduler is None:
        raise ConfigError("--tls goes with --scheduler tls://HOST:8786")
    if scheduler is None:
        return None
    from spikingtac.batch.cluster import check_address

    return check_address(scheduler, tls)


def require_folder(output: Path | None, verb: str) -> Path:
    """Return the folder that results of many recordings go to.

    Raises:
        ConfigError: None is given, or the name of a file is.
    """
    if output is None or (output.suffix and not output.is_dir()) or output.is_file():
        given = "none is given" if output is None else f"{str(output)!r} is given"
        raise ConfigError(
            f"{verb} of many recordings writes into a folder, {given}; "
            "give its name without an ending: -o results"
        )
    return output


def run_many(batch: Batch, args: ManyArgs) -> int:
    """Work on many recordings and say what came out; 1 where one failed, 0 otherwise."""
    from spikingtac.batch.run import run_batch

    runner = PoolRunner(args)
    name = f"{batch.name}: {len(batch.recordings)} recordings"
    try:
        with progress(name) as advance:
            result = run_batch(batch, runner, args.resume, args.overwrite, advance)
    except KeyboardInterrupt:
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    if args.json:
        emit_json(_document(result, batch))
    else:
        _print(result, batch)
    return 1 if result.failed else 0


class PoolRunner:
    """Chooses the workers; a wrong address is refused before anything is written."""

    def __init__(self, args: ManyArgs) -> None:
        self._args = args
        self._address = check_workers(args.workers, args.scheduler, args.tls)

    def __call__(self, jobs: Iterable[FileJob]) -> Iterator[Outcome]:
        """Yield the outcome of every job, from a cluster or from worker processes."""
        if self._address:
            from spikingtac.batch.cluster import run_on_cluster

            return run_on_cluster(jobs, self._address, self._args.tls)
        from spikingtac.batch.processes import run_in_processes

        return run_in_processes(jobs, self._args.workers)


def _document(result: BatchResult, batch: Batch) -> dict[str, Any]:
    return {
        "output": str(batch.folder),
        "recordings": len(result.rows),
        "done": len(result.rows) - result.failed,
        "failed": result.failed,
        "outliers": result.odd,
        "kept": result.kept,
        "table": str(result.table),
        "report": str(result.report),
        "rows": [_plain(row) for row in result.rows],
    }


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    odd = row["outliers"]
    return {**row, "outliers": {} if odd is None else json.loads(odd)}


def _print(result: BatchResult, batch: Batch) -> None:
    from spikingtac.batch.report import reason

    first = [row for row in result.rows if reason(row)]
    if first:
        emit_table(
            "failed, or unlike the others",
            ("recording", "status", "why"),
            [(Path(str(r["source"])).name, r["status"], reason(r)) for r in first[:SHOWN]],
            words=3,
        )
    if len(first) > SHOWN:
        remark(f"and {len(first) - SHOWN} more, in the report")
    kept = f", {result.kept} of them kept from before" if result.kept else ""
    done = len(result.rows) - result.failed
    remark(f"{done} of {len(result.rows)} recordings done{kept}, {result.failed} failed")
    remark(f"table: {result.table}; report: {result.report}")
