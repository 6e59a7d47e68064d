"""``spikingtac convert``: write an event file in another format, or a part of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, progress, remark
from spikingtac.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Args:
    """Write an event file in another format, chosen by the ending; damage is repaired."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="in", metavar="IN")]
    """Event file, recording folder, or camera to read: its address, a named pipe, or -."""
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="out", metavar="OUT")]
    """File to write: .raw, .npz, .csv, .es, .h5 or .aedat4."""
    from_us: int | None = None
    """First microsecond to keep."""
    to_us: int | None = None
    """First microsecond after the part to keep."""
    flip_polarity: bool = False
    """Exchange ON and OFF, so that dark markers read as white ones."""
    encoding: Annotated[str | None, tyro.conf.arg(metavar="evt2|evt21|evt3")] = None
    """Encoding of a .raw file; EVT3 unless given."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    overwrite: bool = False
    """Replace a file that is already there."""
    strict: bool = False
    """Refuse a damaged file instead of repairing it."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Copy the events and print how many were written."""
    from spikingtac.atomic_files import require_free
    from spikingtac.events.create import create_events
    from spikingtac.events.filters import flip_polarity, time_slice
    from spikingtac.events.open import open_events

    _refuse_same_file(args.source, args.target)
    require_free(args.target, args.overwrite)
    if args.from_us is not None and args.to_us is not None and args.from_us >= args.to_us:
        raise ConfigError(f"--from-us {args.from_us} must be before --to-us {args.to_us}")
    source = open_events(args.source, strict=args.strict, sensor=args.sensor)
    written = 0
    with (
        ending_on_interrupt(source),
        create_events(args.target, source.size, encoding=args.encoding) as writer,
        progress(f"writing {args.target.name}") as advance,
    ):
        for packet in time_slice(source, args.from_us, args.to_us):
            writer.write(flip_polarity(packet) if args.flip_polarity else packet)
            written += len(packet)
            advance(source.progress)
    anomalies = dict(source.losses.kinds())
    if args.json:
        emit_json(
            {
                "input": str(args.source),
                "output": str(args.target),
                "format": source.format,
                "size": list(source.size),
                "events": written,
                "anomalies": anomalies,
            }
        )
        return 0
    for note in source.notes:
        remark(f"note: {note}")
    for kind, count in anomalies.items():
        remark(f"note: {kind} {count} times in the input")
    remark(f"{written} events written to {args.target}")
    return 0


def _refuse_same_file(source: Path, target: Path) -> None:
    inner = source / "events.raw" if source.is_dir() else source
    if target.exists() and inner.exists() and target.samefile(inner):
        raise ConfigError(f"{str(target)!r} is the input itself; give another name")
