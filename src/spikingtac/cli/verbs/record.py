"""``spikingtac record``: a camera to disk, without losing an event in silence."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.interrupt import ending_on_interrupt
from spikingtac.cli.messages import emit_json, emit_table, remark
from spikingtac.cli.options import WriteArgs
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.stream.record import Session

EXIT_MACHINE = 3
MEV = 1e6
MB = 1e6


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
    from spikingtac.events.address import Address
    from spikingtac.events.camera_source import CameraSource
    from spikingtac.events.formats.file_source import ReadOptions
    from spikingtac.stream.record import RecordOptions, locked_folder, prepare_folder, record
    from spikingtac.stream.recorder import Split

    if args.seconds is not None and not args.seconds > 0.0:
        raise ConfigError(f"--seconds is {args.seconds:g}, it must be above 0")
    options = RecordOptions(
        split=Split.parse(args.split),
        seconds=math.inf if args.seconds is None else args.seconds,
    )
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
    if args.json:
        emit_json(summary)
    else:
        _print(summary)
    return _ended_well(summary, args.output)


def _ended_well(summary: dict[str, Any], output: Path) -> int:
    """Return the exit code; say what a disk has refused."""
    for told in (summary, summary.get("second", summary)):
        if told["failure"] is not None:
            remark(
                f"spikingtac: error: nothing more could be written ({told['failure']}); "
                f"{told['events']} events are in {str(output)!r} and can be read, "
                f"{told['lost_events']} were lost; make room, or choose another disk"
            )
            return EXIT_MACHINE
    return 0


def camera_address(source: Path) -> str:
    """Return the address that a source means; a pipe is one, too.

    Raises:
        ConfigError: It is a file or a folder.
    """
    from spikingtac.events.address import is_address, is_stream

    if is_address(source):
        return str(source)
    if is_stream(source):
        return f"pipe:{source}"
    if source.exists():
        raise ConfigError(
            f"{str(source)!r} is recorded already; to copy it or a part of it: "
            "spikingtac convert IN OUT"
        )
    raise ConfigError(
        f"{str(source)!r} is no camera; give an address, as udp:7777?encoding=evt2&size=320x320, "
        "or a named pipe (spikingtac cameras lists what is plugged in)"
    )


@contextmanager
def _screen() -> Iterator[Callable[[Sequence[Session]], object]]:
    """Yield what shows the progress: one line on stderr where it is a terminal."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return
    try:
        yield lambda shown: sys.stderr.write("\r\x1b[2K" + " | ".join(map(line, shown)))
    finally:
        sys.stderr.write("\r\x1b[2K")


def line(session: Session) -> str:
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


def _print(summary: dict[str, Any]) -> None:
    second = summary.get("second")
    emit_table(f"recording {summary['output']}", ("", ""), _rows(summary), words=2)
    if second is None:
        return
    emit_table("the second camera", ("", ""), _rows(second), words=2)
    base = summary["time_base"]
    if base is not None:
        remark(
            f"the second clock is on the first one within {base['error_us']:.0f} us, but for what "
            "the cameras' transports differ by; spikingtac align finds that by what both feel"
        )


def _rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    delivery = summary["delivery"]
    clock = summary["clock"]
    rows = [
        ("recorded", f"{summary['seconds']:.1f} s, ended by: {ENDED[summary['ended']]}"),
        ("events", f"{summary['events']} on disk, {summary['lost_events']} lost"),
        ("files", f"{summary['files']}, {summary['bytes'] / MB:.1f} MB"),
        ("reconnects", f"{delivery['reconnects']}, away for {delivery['away_s']:.1f} s"),
    ]
    if delivery["interval_p50_ms"] is not None:
        interval = (
            f"{delivery['interval_p50_ms']:.1f} ms, 99 %: {delivery['interval_p99_ms']:.1f} ms"
        )
        rows.append(("delivered every", interval))
    if clock is not None and clock["drift_error_ppm"] is not None:
        drift = f"{clock['drift_ppm']:.1f} +- {clock['drift_error_ppm']:.1f} ppm against this host"
        rows.append(("camera's clock", drift))
    pace = summary["camera"].get("pace")
    if pace is not None:
        late = f"{pace['late_packets']} of {pace['packets']} packets late"
        rows.append(("real time", f"{late}, at worst by {pace['latest_ms']:.0f} ms (simulated)"))
    return rows + [(kind, str(count)) for kind, count in summary["losses"].items()]


# Why a recording ended, in words.
ENDED = {
    "closed": "Ctrl-C",
    "seconds": "--seconds",
    "ended": "the camera",
    "lost": "the camera, which is gone",
    "disk": "the disk",
}
