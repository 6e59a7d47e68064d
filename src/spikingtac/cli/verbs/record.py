"""``spikingtac record`` and ``align``: cameras to disk, two fingers and poses on one clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

import spikingtac as st
from spikingtac import events
from spikingtac.cli.messages import Table, counted, progress, remark, tell
from spikingtac.cli.options import Output, WriteArgs
from spikingtac.cli.sources import anomalies_of, camera_address, ending_on_interrupt
from spikingtac.events.align import (
    By,
    PoseClock,
    load_poses,
    map_between,
    map_of_poses,
    second_finger,
    write_pair,
)
from spikingtac.events.recording import name_of

if TYPE_CHECKING:
    from spikingtac.stream.recorder import Recorder

MB = 1e6

SECOND_CLOCK = (
    "the second clock is on the first one within {error_us:.0f} us, but for what the cameras' "
    "transports differ by; where both time one line, spikingtac align --by triggers finds that"
)

# Why a recording ended, in words.
ENDED = {
    "closed": "Ctrl-C or SIGTERM",
    "seconds": "--seconds",
    "ended": "the camera",
    "lost": "the camera, which is gone",
    "disk": "the disk",
}


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Record a camera into a folder until Ctrl-C; what was received stays, whatever happens.

    Every event is on disk or counted as lost. The folder can be read like any recording, also
    after a crash, a full disk or an unplugged cable. A camera that is unplugged is waited for.
    Other programs see the events meanwhile where its address says so: udp:7777?share=press, then
    spikingtac view ring:press.

    Attributes:
        source: Address of a camera (spikingtac cameras lists them), a named pipe, or -.
        second: The other finger's camera: events_1.raw, manifest_1.json, on the first one's clock.
        output: Folder to write: events.raw (EVT3), later files events.0001.raw ..., manifest.json.
        seconds: Length, s; until Ctrl-C unless given.
        split: When the next file begins: a size (500MB, 2GB) or a duration (60s, 10min, 1h).
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    second: Annotated[Path | None, tyro.conf.arg(metavar="SOURCE")] = None
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    seconds: float | None = None
    split: Annotated[str, tyro.conf.arg(metavar="SIZE|TIME")] = "1GB"


def run(args: Args) -> int:
    """Record, and print what was recorded; exit 3 where the disk refused to write."""
    from spikingtac.stream.record import locked_folder, parse_split, prepare_folder, record

    split, seconds = parse_split(args.split), args.seconds or math.inf
    given = [args.source] if args.second is None else [args.source, args.second]
    addresses = [events.Address.parse(camera_address(source)) for source in given]
    remark(f"opening {' and '.join(map(str, addresses))}; Ctrl-C ends the recording")
    with ExitStack() as opened:
        opened.enter_context(locked_folder(args.output, args.overwrite))
        sources = [
            events.CameraSource(one, events.ReadOptions(), when_lost="reconnect")
            for one in addresses
        ]
        prepare_folder(args.output, args.overwrite)
        opened.enter_context(ending_on_interrupt(*sources))
        show = partial(_show, set())
        summary = record(sources, args.output, split=split, seconds=seconds, show=show)
    shown: list[Table | str] = [_table(f"recording {summary['output']}", summary)]
    if "second" in summary:
        shown.append(_table("the second camera", summary["second"]))
        if (base := summary["time_base"]) is not None:
            shown.append(SECOND_CLOCK.format_map(base))
    tell(args.json, summary, *shown)
    for told in (summary, summary.get("second", summary)):
        if told["failure"] is not None:
            remark(
                f"spikingtac: error: nothing more could be written ({told['failure']}); "
                f"{told['events']} events are in {str(args.output)!r} and can be read, "
                f"{told['lost_events']} were lost; make room, or choose another disk"
            )
            return 3  # the machine is at fault
    return 0


def _show(told: set[str], recorders: Sequence[Recorder]) -> None:
    """Tell once that a camera is gone, and that the disk is too slow."""
    for one in recorders:
        camera, address = one.source.health(), one.source.address
        for line, applies in (
            (f"{address} is gone; waiting for it", not camera.connected),
            (f"the disk is too slow for {address}: events are lost", one.missed),
        ):
            if applies and line not in told:
                told.add(line)
                remark(line)


def _table(title: str, summary: dict[str, Any]) -> Table:
    delivery, clock = summary["delivery"], summary["clock"] or {}
    rows = {
        "recorded": f"{summary['seconds']:.1f} s, ended by: {ENDED[summary['ended']]}",
        "events": f"{summary['events']} on disk, {summary['lost_events']} lost",
        "files": f"{summary['files']}, {summary['bytes'] / MB:.1f} MB",
        "reconnects": "{reconnects}, away for {away_s:.1f} s".format_map(delivery),
    }
    if delivery["interval_p50_ms"] is not None:
        every = "{interval_p50_ms:.1f} ms, 99 %: {interval_p99_ms:.1f} ms"
        rows["delivered every"] = every.format_map(delivery)
    if clock.get("drift_error_ppm") is not None:
        drift = "{drift_ppm:.1f} +- {drift_error_ppm:.1f} ppm against this host"
        rows["camera's clock"] = drift.format_map(clock)
    if (pace := summary["camera"].get("pace")) is not None:
        late = (
            "{late_packets} of {packets} packets late, at worst by {latest_ms:.0f} ms (simulated)"
        )
        rows["real time"] = late.format_map(pace)
    return Table(title, ("", ""), (rows | summary["losses"]).items(), words=2)


@dataclass(frozen=True, kw_only=True)
class AlignArgs(WriteArgs):
    """Put two fingers, and a robot's poses, on one clock; say how well it is known.

    Two recordings go into a folder that every verb reads as two sensors: events.raw, events_1.raw,
    poses.npz. Without a second recording, the poses alone are written: -o poses.npz.

    Attributes:
        first: Recording whose clock is the time base; a folder of two sensors holds the second one,
            too.
        second: Recording of the other finger.
        output: Folder to write, or poses.npz; nothing is written unless given.
        by: What aligns the clocks: host (one recorded both), triggers (both timed one line), or
            auto.
        trigger_channel: Trigger input of that line, where both recordings hold several; it means
            --by triggers.
        poses: CSV of a robot's poses: a header with t_us, t_ms, t_s or timestamp; columns of
            numbers.
        poses_clock: Clock of their times: unix (time of day), monotonic (of the host), or sensor.
    """

    first: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FIRST")]
    second: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SECOND")] = None
    output: Output = None
    by: By = "auto"
    trigger_channel: int | None = None
    poses: Path | None = None
    poses_clock: PoseClock = "auto"


def align(args: AlignArgs) -> int:
    """Find the maps, write the aligned files, and report the errors."""
    from spikingtac.stream.record import recorded

    second, output = args.second, args.output
    if second is None and (args.first / name_of("events.raw", 1)).is_file():
        second = args.first
    args.refuse("is the clock of --poses", "poses_clock", where=args.poses is None)
    args.refuse("is for two fingers", "by", "trigger_channel", where=second is None)
    if second is None and args.poses is None:
        raise st.ConfigError("there is nothing to align: name a second recording, or --poses")
    if output is not None and second is not None:
        recorded(output, args.overwrite)
        output /= "poses.npz"
    else:
        args.claim(output, endings=(".npz",))
    document: dict[str, Any] = {"output": None if args.output is None else str(args.output)}
    poses = time_map = None
    with progress("comparing clocks"):
        if args.poses is not None:
            poses = load_poses(args.poses)
            time_map, clock = map_of_poses(poses, args.first, args.poses_clock)
            ends_us = [time_map.error_at_us(float(poses.t_us[end])) for end in (0, -1)]
            told = {"rows": len(poses.t_us), "clock": clock, **time_map.summary()}
            document["poses"] = told | {"error_at_end_us": max(ends_us)}
        if second is not None:
            document |= _two(args, second)
    if poses is not None and time_map is not None and output is not None:
        poses.save(output, time_map)
    return tell(args.json, document, *counted(document.get("anomalies", {})), *_aligned(document))


def _two(args: AlignArgs, second: Path) -> dict[str, Any]:
    from spikingtac.stream.record import prepare_folder, recorded

    other, own = second_finger(args.first, second)
    by = args.by if args.trigger_channel is None else "triggers"
    time_map, host_later_us = map_between(args.first, other, own, by, args.trigger_channel)
    told: dict[str, Any] = {"time_base": time_map.summary(), "host_later_us": host_later_us}
    if args.output is None:
        return told
    gone = [args.output, *recorded(args.output, args.overwrite)]
    if any(one.exists() and one.samefile(path) for one in gone for path in (args.first, second)):
        raise st.ConfigError("-o names a recording that is read; choose another folder")
    prepare_folder(args.output, args.overwrite)
    first, inputs = st.open_events(args.first), [args.first.name, second.name]
    told["events"] = write_pair(args.output, first, other, time_map, {"inputs": inputs})
    return told | {"anomalies": anomalies_of(first, other)}


def _aligned(document: dict[str, Any]) -> list[Table]:
    rows = []
    for name, key in (("second sensor", "time_base"), ("poses", "poses")):
        if (found := document.get(key)) is not None:
            drift = f"{found['drift_ppm']:.2f}"
            if found["drift_error_ppm"] is not None:
                drift += f" +- {found['drift_error_ppm']:.2f}"
            shift_ms = f"{(found['base_us'] - found['own_us']) / 1e3:.3f}"
            rows.append((name, found["learned_from"], shift_ms, f"{found['error_us']:.0f}", drift))
    columns = ("clock of the", "found by", "ms to add", "error us", "drift ppm")
    tables = [Table("on the first sensor's clock", columns, rows, words=2)]
    if (later_us := document.get("host_later_us")) is not None:
        title = "the host puts the second sensor later, by"
        tables.append(Table(title, ("us",), [(f"{later_us:.0f}",)], 0))
    return tables
