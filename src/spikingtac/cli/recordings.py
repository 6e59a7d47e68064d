"""Verbs that work on recordings: on one, on those of two fingers, or on many into a folder."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro

import spikingtac as st
from spikingtac.batch.inputs import EVENT_MEMBERS, find_recordings, is_many
from spikingtac.batch.run import TABLE, Batch, run_batch
from spikingtac.cli.messages import Advance, Table, no_progress, progress, remark, tell
from spikingtac.cli.options import JsonArgs, ReadArgs, WriteArgs
from spikingtac.cli.sources import ending_on_interrupt, for_each, open_two
from spikingtac.errors import ConfigError
from spikingtac.events.recording import name_of

SHOWN = 20  # Failures that are printed; the table holds all.

# Options that change no result.
APART = frozenset(("json", "overwrite", "workers", "resume", "output"))


@dataclass(frozen=True, kw_only=True)
class ManyArgs(WriteArgs, ReadArgs):
    """Options of verbs that take many recordings.

    Attributes:
        workers: Many recordings: worker processes; one for every CPU unless given.
        resume: Many recordings: go on with the run in the folder.
    """

    workers: int | None = None
    resume: bool = False


@dataclass(frozen=True, kw_only=True)
class SecondArgs(JsonArgs):
    """Options of verbs that take two fingers.

    Attributes:
        second: The other finger: its recording or camera, put on the first one's clock.
        second_calibration: calibration.json of the other finger.
    """

    second: Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")] = None
    second_calibration: Path | None = None


class Work(NamedTuple):
    """What a verb does with a recording; workers import its functions by their names.

    Attributes:
        verb: Its name.
        one: Takes the arguments, a recording (its path, or opened), the output and a progress bar;
            writes the output and returns the document that is printed.
        row: Takes a document; returns the figures of its row in the table of many.
        shown: Takes a document, the recording's name and the first finger's document; returns what
            a reader sees.
        endings: Valid endings of the output, any where there are none; many get the first.
        check: Takes the arguments; refuses what is wrong for all of many.
        members: Arrays that tell a recording from other archives.
    """

    verb: str
    one: Callable[[Any, Any, Any, Advance], dict[str, Any]]
    row: Callable[[dict[str, Any]], Mapping[str, Any]]
    shown: Callable[[dict[str, Any], str, dict[str, Any]], Iterable[Table | str]]
    endings: Sequence[str]
    check: Callable[[Any], object] = lambda args: None
    members: Sequence[str] = EVENT_MEMBERS


def run_each(work: Work, args: Any, given: Sequence[Path], output: Path | None) -> int:
    """Work on what is given: one recording, two fingers, or many."""
    many = means_many(args, given)
    if args.second is not None:
        return _run_two(work, args, given, output, many)
    args.refuse("is for the other finger: --second RECORDING", "second_calibration")
    return run_many(work, args, given) if many else run_one(work, args, given[0], output)


def run_one(work: Work, args: Any, recording: Path, output: Path | None) -> int:
    """Work on one recording and say what came out."""
    args.claim(output, endings=work.endings)
    with progress(f"{work.verb} {recording.name}") as advance:
        found = work.one(args, recording, output, advance)
    written = [f"written: {output}"] if output else []
    return tell(args.json, found, *work.shown(found, recording.name, found), *written)


def _run_two(work: Work, args: Any, given: Sequence[Path], output: Path | None, many: bool) -> int:
    """Work on two fingers, on the first one's clock."""
    if many:
        raise ConfigError("--second is the other finger of one recording; give a single one")
    if args.calibration is None or args.second_calibration is None:
        raise ConfigError(
            "two fingers need a calibration each: --calibration and --second-calibration"
        )
    args.refuse("is for one finger", "sensor")
    first, fingers = given[0], (args, replace(args, calibration=args.second_calibration))
    second = None if output is None else output.with_name(name_of(output.name, 1))
    outputs = [path for path in (output, second) if path]
    args.claim(*outputs, endings=work.endings)

    def one(number: int, source: st.EventSource) -> dict[str, Any]:
        return work.one(fingers[number], source, outputs[number] if outputs else None, no_progress)

    sources = open_two(first, args.second, strict=args.strict)
    with ending_on_interrupt(*sources):
        found, other = for_each(one, sources)
    shown = [*work.shown(found, first.name, found), *work.shown(other, args.second.name, found)]
    written = [f"written: {path}" for path in outputs]
    return tell(args.json, found | {"second": other}, *shown, *written)


def means_many(args: ManyArgs, given: Sequence[Path]) -> bool:
    """Return whether a verb shall work on many recordings, into a folder."""
    return args.workers is not None or args.resume or is_many(given)


def the_only_one(given: Sequence[Path], members: Sequence[str] = EVENT_MEMBERS) -> str:
    """Return a hint for an error where what is given holds a single recording.

    Raises:
        ConfigError: It holds none.
    """
    found = find_recordings(given, members)
    alone = len(found) == 1 and found[0] != given[0]
    return f"; or name what {str(given[0])!r} holds: {str(found[0])!r}" if alone else ""


def run_many(work: Work, args: Any, given: Sequence[Path]) -> int:
    """Work on many recordings and say what came out; 1 where one failed, 0 otherwise."""
    folder: Path | None = args.output
    if folder is None or (folder.suffix and not folder.is_dir()) or folder.is_file():
        named = "none is given" if folder is None else f"{str(folder)!r} is given"
        raise ConfigError(
            f"{work.verb} of many recordings writes into a folder, {named}; "
            "give its name without an ending: -o results"
            f"{the_only_one(given, work.members)}"
        )
    work.check(args)
    fixed = _absolute(args)
    batch = Batch(
        name=work.verb,
        work=partial(_row, work.one, work.row, fixed),
        recordings=find_recordings(given, work.members, folder),
        folder=folder,
        ending=work.endings[0],
        settings={
            name: str(value) if isinstance(value, Path) else value
            for name, value in vars(fixed).items()
            if name not in APART and not (value is None or value is False or value == ())
        },
        workers=args.workers,
    )
    try:
        with progress(f"{work.verb}: {len(batch.recordings)} recordings") as advance:
            rows, kept = run_batch(batch, args.resume, args.overwrite, advance)
    except (KeyboardInterrupt, SystemExit):
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    return _told(rows, kept, folder, args.json)


def _row(
    one: Callable[..., Any], row: Callable[..., Any], args: Any, recording: Path, output: Path
) -> Mapping[str, Any]:
    """Work on one of many recordings, in a worker."""
    return row(one(args, recording, output, no_progress))


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


def _absolute(args: Any) -> Any:
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
