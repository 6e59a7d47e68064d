"""``spikingtac record``: a camera to disk, without losing an event in silence."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli.messages import Table, remark, tell
from spikingtac.cli.options import WriteArgs, require_seconds
from spikingtac.cli.sources import camera_address, ending_on_interrupt
from spikingtac.events.address import Address
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.stream.record import RecordOptions, Session, locked_folder, prepare_folder, record
from spikingtac.stream.recorder import Split

EXIT_MACHINE = 3
MEV = 1e6
MB = 1e6
CLEAR_LINE = "\r\x1b[2K"  # Begins the line of a terminal anew.

# Why a recording ended, in words.
ENDED = {
    "closed": "Ctrl-C",
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
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Address of a camera (spikingtac cameras lists them), a named pipe, or -."""
    second: Annotated[Path | None, tyro.conf.arg(metavar="SOURCE")] = None
    """The other finger's camera: events_1.raw, manifest_1.json, on the first one's clock."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")]
    """Folder to write: events.raw (EVT3), later files events.0001.raw ..., manifest.json."""
    seconds: float | None = None
    """Length, s; until Ctrl-C unless given."""
    split: Annotated[str, tyro.conf.arg(metavar="SIZE|TIME")] = "1GB"
    """When the next file begins: a size (500MB, 2GB) or a duration (60s, 10min, 1h)."""


def run(args: Args) -> int:
    """Record, and print what was recorded; exit 3 where the disk refused to write."""
    require_seconds(args.seconds)
    options = RecordOptions(split=Split.parse(args.split), seconds=args.seconds or math.inf)
    given = [args.source] if args.second is None else [args.source, args.second]
    addresses = [Address.parse(camera_address(source)) for source in given]
    remark(f"opening {' and '.join(map(str, addresses))}; Ctrl-C ends the recording")
    with ExitStack() as opened:
        opened.enter_context(locked_folder(args.output, args.overwrite))
        sources = [CameraSource(one, ReadOptions(), when_lost="reconnect") for one in addresses]
        prepare_folder(args.output, args.overwrite)
        opened.enter_context(ending_on_interrupt(*sources))
        show = opened.enter_context(_screen())
        summary = record(sources, args.output, options, show)
    tell(args.json, summary, *_shown(summary))
    for told in (summary, summary.get("second", summary)):
        if told["failure"] is not None:
            remark(
                f"spikingtac: error: nothing more could be written ({told['failure']}); "
                f"{told['events']} events are in {str(args.output)!r} and can be read, "
                f"{told['lost_events']} were lost; make room, or choose another disk"
            )
            return EXIT_MACHINE
    return 0


@contextmanager
def _screen() -> Iterator[Callable[[Sequence[Session]], object]]:
    """Yield what shows the progress: one line on stderr where it is a terminal."""
    if not sys.stderr.isatty():
        yield lambda shown: None
        return
    try:
        yield lambda shown: sys.stderr.write(CLEAR_LINE + " | ".join(map(_line, shown)))
    finally:
        sys.stderr.write(CLEAR_LINE)


def _line(session: Session) -> str:
    """Return the progress in one line."""
    disk, camera = session.recorder, session.source.health()
    files = len(disk.parts)
    parts = [
        f"{session.seconds:.1f} s",
        f"{camera.rate_ev_s / MEV:.3f} Mev/s",
        f"{disk.written_bytes / MB:.1f} MB in {files} file{'s' * (files != 1)}",
    ]
    if camera.interval_p50_ms is not None:
        parts.append(f"a packet every {camera.interval_p50_ms:.1f} ms")
    if not camera.connected:
        parts.append("THE CAMERA IS GONE, waiting for it")
    if disk.lost_events:
        parts.append(f"LOST {disk.lost_events} events: the disk is too slow")
    parts += [f"{kind} {count}" for kind, count in camera.losses.items()]
    return "  ".join(parts)


def _shown(summary: dict[str, Any]) -> list[Table | str]:
    shown: list[Table | str] = [_table(f"recording {summary['output']}", summary)]
    if "second" in summary:
        shown.append(_table("the second camera", summary["second"]))
        if (base := summary["time_base"]) is not None:
            shown.append(
                f"the second clock is on the first one within {base['error_us']:.0f} us, but for "
                "what the cameras' transports differ by; spikingtac align finds that by what both "
                "feel"
            )
    return shown


def _table(title: str, summary: dict[str, Any]) -> Table:
    delivery, clock = summary["delivery"], summary["clock"]
    rows = {
        "recorded": f"{summary['seconds']:.1f} s, ended by: {ENDED[summary['ended']]}",
        "events": f"{summary['events']} on disk, {summary['lost_events']} lost",
        "files": f"{summary['files']}, {summary['bytes'] / MB:.1f} MB",
        "reconnects": f"{delivery['reconnects']}, away for {delivery['away_s']:.1f} s",
    }
    if delivery["interval_p50_ms"] is not None:
        p50_ms, p99_ms = delivery["interval_p50_ms"], delivery["interval_p99_ms"]
        rows["delivered every"] = f"{p50_ms:.1f} ms, 99 %: {p99_ms:.1f} ms"
    if clock is not None and clock["drift_error_ppm"] is not None:
        drift = f"{clock['drift_ppm']:.1f} +- {clock['drift_error_ppm']:.1f} ppm against this host"
        rows["camera's clock"] = drift
    if (pace := summary["camera"].get("pace")) is not None:
        late = f"{pace['late_packets']} of {pace['packets']} packets late"
        rows["real time"] = f"{late}, at worst by {pace['latest_ms']:.0f} ms (simulated)"
    rows |= {kind: str(count) for kind, count in summary["losses"].items()}
    return Table(title, ("", ""), rows.items(), words=2)
