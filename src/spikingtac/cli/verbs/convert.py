"""``spikingtac convert`` and ``export``: recordings in other formats, tracks as data sets."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

import spikingtac as st
from spikingtac import events
from spikingtac.batch.inputs import find_recordings
from spikingtac.cli.messages import Advance, Table, counted, figures, progress, tell
from spikingtac.cli.options import Output, WriteArgs, whole_numbers
from spikingtac.cli.recordings import ManyArgs, Work, means_many, run_many, run_one, the_only_one
from spikingtac.cli.sources import anomalies_of, ending_on_interrupt
from spikingtac.datasets.export import data_set, write_zarr
from spikingtac.datasets.lerobot import write_lerobot


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """Write an event file in another format, chosen by the ending; damage is repaired.

    Many files (with -o) go into a folder, with a table of all results:
    spikingtac convert DAY -o DAY_npz --to npz --workers 4

    Attributes:
        files: Event file, recording folder, or camera to read (its address, a named pipe, or -),
            and the file to write: .raw, .npz, .csv, .h5 or .aedat4. With -o, all of them are read:
            files, folders of recordings, patterns such as 'day/*.raw'.
        output: Many files: the folder to write.
        to: Many files: the format to write.
        from_us: First microsecond to keep.
        to_us: First microsecond after the part to keep.
        flip_polarity: Exchange ON and OFF, so that dark markers read as white ones.
        size: Size of the sensor, px, whatever the file says of it: 640x480 or 640 480.
        crop: Part to keep, px: first column and row, those after the last; its corner is the
            origin.
        flip: Mirror what --crop keeps: x exchanges left and right, y top and bottom.
        rotate: Turn the picture clockwise after that, degrees.
        shift_us: Add to all times, us; --from-us and --to-us are times before it.
        hot_pixels: Keep or leave out the events of pixels that send all the time.
        encoding: Encoding of a .raw file; EVT3 unless given.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="IN [OUT]")]
    output: Output = None
    to: Annotated[str | None, tyro.conf.arg(metavar="raw|npz|csv|h5|aedat4")] = None
    from_us: int | None = None
    to_us: int | None = None
    flip_polarity: bool = False
    size: Annotated[tuple[int, int] | None, whole_numbers(2, "W H")] = None
    crop: Annotated[tuple[int, int, int, int] | None, whole_numbers(4, "X0 Y0 X1 Y1")] = None
    flip: Literal["x", "y"] | None = None
    rotate: Literal[90, 180, 270] | None = None
    shift_us: int = 0
    hot_pixels: Literal["keep", "drop"] = "keep"
    encoding: Annotated[str | None, tyro.conf.arg(metavar="evt2|evt21|evt3")] = None


def run(args: Args) -> int:
    """Copy the events and print how many were written."""
    if args.output is not None or args.to is not None:
        from spikingtac.events.create import writer_of

        if args.to is None:
            raise st.ConfigError("of many files, convert needs the format to write: --to npz")
        writer_of(args.to, args.encoding)  # refuses what cannot be written
        ending = "." + args.to.lower().removeprefix(".")
        return run_many(WORK._replace(endings=(ending,)), args, args.files)
    if len(args.files) != 2 or means_many(args, args.files[:1]):
        raise st.ConfigError(
            "convert takes a file to read and a file to write; of many files, it takes "
            "all of them and the folder and format to write: -o FOLDER --to npz"
            f"{the_only_one(args.files[:1])}"
        )
    return run_one(WORK, args, *args.files)


def convert_one(args: Args, path: Path, target: Path, advance: Advance) -> dict[str, Any]:
    """Convert a recording, and return the figures."""
    same = ("from_us", "to_us", "shift_us", "flip_polarity", "flip")
    given = {name: getattr(args, name) for name in same}
    change = events.Transform(**given, crop_px=args.crop, rotate_deg=args.rotate or 0)
    source = args.open(path, size=args.size)
    if args.hot_pixels == "drop" and events.is_stream(source.path):
        raise st.ConfigError("--hot-pixels drop reads a recording twice; record the camera first")
    hot_px = events.hot_pixels_of(source) if args.hot_pixels == "drop" else None
    size, written, edges = change.size(source.size), 0, 0
    writing = st.create_events(target, size, encoding=args.encoding)
    with ending_on_interrupt(source), writing as writer:
        for packet in _changed(source, change, events.HotPixelFilter(hot_px, source.size)):
            edges = _pass_triggers(source, writer, change, edges)
            writer.write(packet)
            written += len(packet)
            advance(source.progress)
        _pass_triggers(source, writer, change, edges)
    notes = list(source.notes)
    if left_out := writer.triggers_left_out:
        notes.append(f"{target.suffix} holds no triggers: {left_out} left out")
    if hot_px is not None and len(hot_px):
        notes.append(f"events of {len(hot_px)} hot pixels left out")
    return {
        "input": str(path),
        "output": str(target),
        "format": source.format,
        "size": list(size),
        "events": written,
        "triggers": len(source.triggers),
        "hot_pixels_dropped": 0 if hot_px is None else len(hot_px),
        "anomalies": anomalies_of(source),
        "health": source.counters().summary(),
        "notes": notes,
    }


def _pass_triggers(
    source: events.FileSource, writer: events.EventWriter, change: events.Transform, passed: int
) -> int:
    """Give the writer the trigger edges that were met since; return how many there are by now."""
    if len(source.triggers) > passed:
        writer.add_triggers(change.triggers(source.triggers.select(slice(passed, None))))
    return len(source.triggers)


def _changed(
    source: events.FileSource, change: events.Transform, hot: events.HotPixelFilter
) -> Iterator[st.EventPacket]:
    """Yield the packets to write.

    Raises:
        RecordingError: The part to keep lies outside of the recording.
    """
    begin_us, end_us, empty = None, 0, True
    for packet in source:
        begin_us, end_us = packet.t_start_us if begin_us is None else begin_us, packet.t_end_us
        if change.to_us is not None and packet.t_start_us >= change.to_us:
            break
        for changed in change.packets([hot.kept(packet)]):
            empty = empty and not len(changed)
            yield changed
    if empty and begin_us is not None:
        raise st.RecordingError(
            f"nothing is kept of {str(source.path)!r}: no event from {begin_us} to {end_us} us "
            "(the file's own times) is in the part that --from-us, --to-us and --crop ask for"
        )


def convert_row(found: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one of many recordings."""
    told = {"format": found["format"], "width": found["size"][0], "height": found["size"][1]}
    return told | {"events": found["events"], "anomalies": sum(found["anomalies"].values())}


def convert_shown(found: dict[str, Any], name: str, first: dict[str, Any]) -> list[Table | str]:
    """Return what a reader sees."""
    notes = [f"note: {note}" for note in found["notes"]]
    return [*notes, *counted(found["anomalies"], "input"), f"{found['events']} events"]


WORK = Work("convert", convert_one, convert_row, convert_shown, ())


@dataclass(frozen=True, kw_only=True)
class ExportArgs(WriteArgs):
    """Write tracks as a data set: LeRobot (v3.0), or Zarr.

    A LeRobot data set has one episode for each recording, with the last values before each frame,
    of the tracks and of a robot's log. A Zarr store has the arrays of tracks.npz at full rate.

    Attributes:
        sources: tracks.npz, several, folders of them, or patterns such as 'day/*.npz'.
        to: Form of the data set.
        output: Folder to write.
        fps: LeRobot: frames per second.
        task: LeRobot: what is done in the recordings, in words.
        log: LeRobot: a robot's log for each recording: .npz with t_us on the clock of the tracks,
            and state (n, k), action (n, k) or both.
    """

    sources: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="TRACKS...")]
    to: Literal["lerobot", "zarr"]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    fps: int = 30
    task: str = "touch"
    log: tuple[Path, ...] = ()


def export(args: ExportArgs) -> int:
    """Export, and say what was written."""
    args.refuse("is for --to lerobot", "log", "fps", "task", where=args.to == "zarr")
    found = find_recordings(args.sources, ("displacement_px.npy",))
    with (
        progress(f"exporting to {args.to}") as advance,
        data_set(args.output, args.to, args.overwrite) as partial,
    ):
        if args.to == "zarr":
            written = write_zarr(partial, found, advance)
        else:
            written = write_lerobot(partial, found, args.log, args.fps, args.task, advance)
    document = {"output": str(args.output), **written}
    return tell(args.json, document, figures(f"{args.to} data set", document))
