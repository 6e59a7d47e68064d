"""The common part of verbs that take many recordings: options, workers, and the last words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from spikingtac.cli.messages import Table, progress, remark, tell
from spikingtac.cli.options import ReadArgs, WriteArgs
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.batch.run import BatchResult

SHOWN = 20  # Failures that are printed; the table holds all.

# Options that change no result.
APART = frozenset(("json", "overwrite", "workers", "scheduler", "resume", "output"))


@dataclass(frozen=True, kw_only=True)
class ManyArgs(WriteArgs, ReadArgs):
    """Options of verbs that take many recordings."""

    workers: int | None = None
    """Many recordings: worker processes; one for every CPU unless given."""
    scheduler: str | None = None
    """Many recordings: a Dask scheduler, tcp://127.0.0.1:8786 or tls://HOST:8786."""
    resume: bool = False
    """Many recordings: go on with the run in the folder."""

    @property
    def named(self) -> Sequence[Path]:
        """The recordings: the one list of paths that is given without an option."""
        return next(
            getattr(self, name)
            for name in ("recordings", "sources", "files")
            if hasattr(self, name)
        )


SomeArgs = TypeVar("SomeArgs", bound=ManyArgs)


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


def run_many(
    name: str,
    args: SomeArgs,
    work: Callable[[SomeArgs, Path, Path], Mapping[str, Any]],
    ending: str,
    check: Callable[[], object] = lambda: None,
    members: Sequence[str] | None = None,
) -> int:
    """Work on many recordings and say what came out; 1 where one failed, 0 otherwise.

    Args:
        name: The verb.
        args: Its arguments; the recordings are those that are given without an option.
        work: Takes the arguments, a recording and its output; writes the output, returns its row.
        ending: Ending of the outputs.
        check: Refuses what is wrong for all of them, before any work is done.
        members: Arrays that tell a recording from other archives; events unless given.
    """
    from spikingtac.batch.inputs import EVENT_MEMBERS, find_recordings
    from spikingtac.batch.run import Batch, Workers, run_batch

    folder = _require_folder(getattr(args, "output", None), name)
    check()
    fixed = _absolute(args)
    batch = Batch(
        name=name,
        work=partial(work, fixed),
        recordings=find_recordings(args.named, members or EVENT_MEMBERS, folder),
        folder=folder,
        ending=ending,
        settings=_settings(fixed),
    )
    workers = Workers(count=args.workers, scheduler=args.scheduler)
    try:
        with progress(f"{name}: {len(batch.recordings)} recordings") as advance:
            result = run_batch(batch, workers, args.resume, args.overwrite, advance)
    except KeyboardInterrupt:
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    return _told(result, folder, args.json)


def _told(result: BatchResult, folder: Path, as_json: bool) -> int:
    count = {"recordings": len(result.rows), "done": len(result.rows) - result.failed}
    document = {"output": str(folder), **count, "failed": result.failed, "kept": result.kept}
    document |= {"table": str(result.table), "rows": result.rows}
    failures = [(Path(row["source"]).name, row["error"]) for row in result.rows if row["error"]]
    kept = f", {result.kept} of them kept from before" if result.kept else ""
    tell(
        as_json,
        document,
        *([Table("failed", ("recording", "why"), failures[:SHOWN], words=2)] if failures else []),
        f"{count['done']} of {len(result.rows)} recordings done{kept}, {result.failed} failed",
        f"written: {folder}, table of all: {result.table}",
    )
    return 1 if result.failed else 0


def _require_folder(output: Path | None, verb: str) -> Path:
    """Return the folder that results of many recordings go to."""
    if output is None or (output.suffix and not output.is_dir()) or output.is_file():
        given = "none is given" if output is None else f"{str(output)!r} is given"
        raise ConfigError(
            f"{verb} of many recordings writes into a folder, {given}; "
            "give its name without an ending: -o results"
        )
    return output


def _absolute(args: SomeArgs) -> SomeArgs:
    """Return arguments with paths that hold wherever a worker runs, and without the recordings."""
    changed: dict[str, Any] = {}
    for name, value in vars(args).items():
        if isinstance(value, Path):
            changed[name] = value.absolute()
        elif isinstance(value, tuple) and any(isinstance(one, Path) for one in value):
            changed[name] = ()
    preset = getattr(args, "preset", "")
    if preset.endswith(".toml"):
        changed["preset"] = str(Path(preset).absolute())
    return replace(args, **changed)


def _settings(args: ManyArgs) -> dict[str, Any]:
    """Return the arguments that all results depend on, as JSON holds them."""
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in vars(args).items()
        if name not in APART and value not in (None, False, ())
    }
