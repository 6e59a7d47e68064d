"""The common part of verbs that take many recordings: options, workers, and the last words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.cli.options import ReadArgs, WriteArgs
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.batch.run import Batch

SHOWN = 20
"""Failures that are printed; the table holds all."""


@dataclass(frozen=True, kw_only=True)
class ManyArgs(WriteArgs, ReadArgs):
    """Options of verbs that take many recordings."""

    workers: int | None = None
    """Many recordings: worker processes; one for every CPU unless given."""
    scheduler: str | None = None
    """Many recordings: a Dask scheduler, tcp://127.0.0.1:8786 or tls://HOST:8786."""
    resume: bool = False
    """Many recordings: go on with the run in the folder."""


def means_many(args: ManyArgs, given: Sequence[Path]) -> bool:
    """Return whether a verb shall work on many recordings, into a folder.

    Raises:
        ConfigError: The options do not go together.
    """
    from spikingtac.batch.inputs import is_many

    if not given:
        raise ConfigError("name a recording, several, a folder of them, or a pattern in quotes")
    check_workers(args.workers, args.scheduler)
    asked = args.workers is not None or args.scheduler is not None or args.resume
    return asked or is_many(given)


def check_workers(workers: int | None, scheduler: str | None) -> None:
    """Refuse workers that do not go together, or a scheduler that is not to be connected to.

    Args:
        workers: Number of processes.
        scheduler: Address of a Dask scheduler.

    Raises:
        ConfigError: They are both given, too few, or the address is refused.
    """
    if workers is not None and scheduler is not None:
        raise ConfigError("--workers are processes here, --scheduler has its own: give one of them")
    if workers is not None and workers < 1:
        raise ConfigError(f"--workers is {workers}, it must be at least 1")
    if scheduler is not None:
        from spikingtac.batch.worker_pool import check_scheduler

        check_scheduler(scheduler)


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
    from spikingtac.batch.run import Workers, run_batch

    workers = Workers(count=args.workers, scheduler=args.scheduler)
    try:
        with progress(f"{batch.name}: {len(batch.recordings)} recordings") as advance:
            result = run_batch(batch, workers, args.resume, args.overwrite, advance)
    except KeyboardInterrupt:
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    done = len(result.rows) - result.failed
    if args.json:
        emit_json(
            {
                "output": str(batch.folder),
                "recordings": len(result.rows),
                "done": done,
                "failed": result.failed,
                "kept": result.kept,
                "table": str(result.table),
                "rows": result.rows,
            }
        )
        return 1 if result.failed else 0
    failures = [(Path(row["source"]).name, row["error"]) for row in result.rows if row["error"]]
    if failures:
        emit_table("failed", ("recording", "why"), failures[:SHOWN], words=2)
    kept = f", {result.kept} of them kept from before" if result.kept else ""
    remark(f"{done} of {len(result.rows)} recordings done{kept}, {result.failed} failed")
    remark(f"written: {batch.folder}, table of all: {result.table}")
    return 1 if result.failed else 0
