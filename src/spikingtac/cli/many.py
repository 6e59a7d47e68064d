"""The common part of verbs that take many recordings: options, workers, and the last words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from spikingtac.batch.inputs import EVENT_MEMBERS, find_recordings, is_many
from spikingtac.batch.run import TABLE, Batch, run_batch
from spikingtac.cli.messages import Table, progress, remark, tell
from spikingtac.cli.options import ReadArgs, WriteArgs
from spikingtac.errors import ConfigError

SHOWN = 20  # Failures that are printed; the table holds all.

# Options that change no result.
APART = frozenset(("json", "overwrite", "workers", "resume", "output"))


@dataclass(frozen=True, kw_only=True)
class ManyArgs(WriteArgs, ReadArgs):
    """Options of verbs that take many recordings."""

    workers: int | None = None
    """Many recordings: worker processes; one for every CPU unless given."""
    resume: bool = False
    """Many recordings: go on with the run in the folder."""


SomeArgs = TypeVar("SomeArgs", bound=ManyArgs)


def means_many(args: ManyArgs, given: Sequence[Path]) -> bool:
    """Return whether a verb shall work on many recordings, into a folder.

    Raises:
        ConfigError: The options do not go together.
    """
    if not given:
        raise ConfigError("name a recording, several, a folder of them, or a pattern in quotes")
    check_workers(args.workers)
    return args.workers is not None or args.resume or is_many(given)


def check_workers(workers: int | None) -> None:
    """Refuse a number of processes below 1.

    Raises:
        ConfigError: There are too few.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"--workers is {workers}, it must be at least 1")


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
        args: Its arguments; the recordings are the one list of paths without an option.
        work: Takes the arguments, a recording and its output; writes the output, returns its row.
        ending: Ending of the outputs.
        check: Refuses what is wrong for all of them, before any work is done.
        members: Arrays that tell a recording from other archives; events unless given.
    """
    folder: Path | None = getattr(args, "output", None)
    if folder is None or (folder.suffix and not folder.is_dir()) or folder.is_file():
        given = "none is given" if folder is None else f"{str(folder)!r} is given"
        raise ConfigError(
            f"{name} of many recordings writes into a folder, {given}; "
            "give its name without an ending: -o results"
        )
    check()
    named = next(vars(args)[key] for key in ("recordings", "sources", "files") if key in vars(args))
    fixed = _absolute(args)
    batch = Batch(
        name=name,
        work=partial(work, fixed),
        recordings=find_recordings(named, members or EVENT_MEMBERS, folder),
        folder=folder,
        ending=ending,
        settings=_settings(fixed),
        workers=args.workers,
    )
    try:
        with progress(f"{name}: {len(batch.recordings)} recordings") as advance:
            rows, kept = run_batch(batch, args.resume, args.overwrite, advance)
    except KeyboardInterrupt:
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    return _told(rows, kept, folder, args.json)


def _told(rows: Sequence[Mapping[str, Any]], kept: int, folder: Path, as_json: bool) -> int:

    failures = [(Path(row["source"]).name, row["error"]) for row in rows if row["error"]]
    failed, done, table = len(failures), len(rows) - len(failures), str(folder / TABLE)
    count = {"recordings": len(rows), "done": done, "failed": failed, "kept": kept}
    document = {"output": str(folder), **count, "table": table, "rows": rows}
    again = f", {kept} of them kept from before" if kept else ""
    tell(
        as_json,
        document,
        *([Table("failed", ("recording", "why"), failures[:SHOWN], words=2)] if failures else []),
        f"{done} of {len(rows)} recordings done{again}, {failed} failed",
        f"written: {folder}, table of all: {table}",
    )
    return 1 if failed else 0


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
