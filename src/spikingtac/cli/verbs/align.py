"""``spikingtac align``: two fingers, and a robot's poses, on one clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli.messages import Table, progress, tell
from spikingtac.cli.options import Output, WriteArgs
from spikingtac.errors import ConfigError
from spikingtac.events.align import By, SecondFinger, map_between, write_pair
from spikingtac.events.manifest import PoseClock, load_poses, map_of_poses, name_of
from spikingtac.events.open import open_events
from spikingtac.stream.record import prepare_folder, recorded


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Put two fingers, and a robot's poses, on one clock; say how well it is known.

    Two recordings go into a folder that every verb reads as two sensors: events.raw, events_1.raw,
    poses.npz. Without a second recording, the poses alone are written: -o poses.npz.
    """

    first: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FIRST")]
    """Recording whose clock is the time base; a folder of two sensors holds the second one, too."""
    second: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SECOND")] = None
    """Recording of the other finger."""
    output: Output = None
    """Folder to write, or poses.npz; nothing is written unless given."""
    by: By = "auto"
    """What aligns the two clocks: host (one host recorded both), or triggers (both cameras timed
    the edges of one line). Auto takes the host where it is known, otherwise the triggers."""
    trigger_channel: int | None = None
    """Trigger input of that line, where both recordings hold several; it means --by triggers."""
    poses: Path | None = None
    """CSV of a robot's poses: a header with t_us, t_ms, t_s or timestamp; columns of numbers."""
    poses_clock: PoseClock = "auto"
    """Clock of their times: unix (time of day), monotonic (of the host), or sensor. Auto tells the
    first two by their size."""


def run(args: Args) -> int:
    """Find the maps, write the aligned files, and report the errors."""
    second, output = args.second, args.output
    if second is None and (args.first / name_of("events.raw", 1)).is_file():
        second = args.first
    if second is None and args.poses is None:
        raise ConfigError("there is nothing to align: name a second recording, or --poses")
    if output is not None and second is not None:
        recorded(output, args.overwrite)
        output /= "poses.npz"
    elif output is not None and output.suffix != ".npz":
        raise ConfigError(f"poses alone are written as .npz, not as {output.name!r}")
    else:
        args.claim(output)
    document: dict[str, Any] = {"output": None if args.output is None else str(args.output)}
    placed = None
    with progress("comparing clocks"):
        if args.poses is not None:
            poses = load_poses(args.poses)
            time_map, clock = map_of_poses(poses, args.first, args.poses_clock)
            placed = poses.on(time_map)
            ends_us = [time_map.error_at_us(float(poses.t_us[end])) for end in (0, -1)]
            told = {"rows": len(placed.t_us), "clock": clock, **time_map.summary()}
            document["poses"] = told | {"error_at_end_us": max(ends_us)}
        if second is not None:
            document |= _two(args, second)
    if placed is not None and output is not None:
        placed.save(output)
    return tell(args.json, document, *_tables(document))


def _two(args: Args, second: Path) -> dict[str, Any]:

    other = SecondFinger(args.first, second)
    by = args.by if args.trigger_channel is None else "triggers"
    time_map, host_later_us = map_between(args.first, other, by, args.trigger_channel)
    told: dict[str, Any] = {"time_base": time_map.summary(), "host_later_us": host_later_us}
    if args.output is None:
        return told
    if args.output.exists() and any(
        path.exists() and args.output.samefile(path) for path in (args.first, second)
    ):
        raise ConfigError("-o names a recording that is read; choose another folder")
    prepare_folder(args.output, args.overwrite)
    first, inputs = open_events(args.first), [args.first.name, second.name]
    written = write_pair(args.output, first, other.source, time_map, {"inputs": inputs})
    return told | {"events": written}


def _tables(document: dict[str, Any]) -> list[Table]:
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
