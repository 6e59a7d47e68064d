"""``spikingtac cameras`` and ``doctor``: what this machine has, lacks, and how to mend it."""

import os
import platform
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro

from spikingtac import events
from spikingtac.cameras.libraries import is_installed, plugged_in, remedy
from spikingtac.cli.messages import Table, tell
from spikingtac.cli.options import JsonArgs
from spikingtac.cli.sources import ending_on_interrupt
from spikingtac.events.camera import KINDS
from spikingtac.kernels import may_hold

# Buffer that a camera's datagrams ask for (``cameras/udp.py``): 0.7 s at 3 Mev/s.
SOCKET_BUFFER_BYTES = 8 << 20

# Interval of deliveries from which on a window of 1 ms is no latency of 1 ms.
LATENCY_LIMIT_MS = 1.0
SLOW_DELIVERY = (
    "ask the maker's driver for smaller transfers (openmv: words=1024; OpenEB's kernel driver: "
    "mipi_frame_period)"
)
NOTHING_CAME = "see that the camera is on, its address is right, and something moves before it"
CACHE_REMEDY = (
    "it cannot be written: set NUMBA_CACHE_DIR to a folder of yours, or every start may compile "
    "again"
)

# A line of a package's requirements: the library, and the extra that brings it.
REQUIREMENT = re.compile(r"([\w.-]+)[^;]*(?:;(?:.*\bextra == ['\"](\w+)['\"])?.*)?")


@dataclass(frozen=True, kw_only=True)
class Args(JsonArgs):
    """List the cameras that are plugged in, and the ways to reach one; nothing is opened.

    An address is accepted wherever a recording is: view, track, calibrate, contact, touch, probe,
    convert, info, and record.
    """


def run(args: Args) -> int:
    """Print what is there, and what is missing."""
    found = list(plugged_in())
    kinds = {
        name: {
            "example": kind.example,
            "about": kind.about,
            "library": kind.module or None,
            "installed": is_installed(name),
        }
        for name, kind in KINDS.items()
    }
    document = {"found": [asdict(item) for item in found], "kinds": kinds}
    shown: list[Table | str] = [
        f"note: {item.model} could not look for cameras ({item.remark})"
        for item in found
        if not item.address
    ]
    seen = [(one.address, one.model, one.serial, one.remark) for one in found if one.address]
    if seen:
        shown.append(Table("plugged in", ("address", "model", "serial", "remark"), seen, words=4))
    else:
        shown.append("no camera is plugged in, or the library that would see it is missing")
    ways = [
        (one["example"], one["about"], "" if one["installed"] else remedy(name))
        for name, one in kinds.items()
    ]
    columns = ("address, as", "what it reads", "missing")
    shown.append(Table("ways to reach a camera", columns, ways, words=3))
    return tell(args.json, document, *shown)


@dataclass(frozen=True, kw_only=True)
class DoctorArgs(JsonArgs):
    """Check this machine: Python, libraries, extras, kernel cache, CPU governor, socket buffer.

    With the address of a camera, also measure how it delivers.

    Attributes:
        source: Address of a camera to listen to, as openmv:/dev/ttyACM0.
        seconds: How long to listen to it, s.
    """

    source: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SOURCE]")] = None
    seconds: float = 3.0


class Finding(NamedTuple):
    """What a check found.

    Attributes:
        name: What was looked at.
        status: ``ok``, ``note`` (works, could be better) or ``fail`` (something will not work).
        found: What is there.
        remedy: What to do about it, empty where nothing is to be done.
    """

    name: str
    status: str
    found: str
    remedy: str = ""


def doctor(args: DoctorArgs) -> int:
    """Print the findings; exit 3 where something will not work."""
    findings = [*_libraries(), *_settings()]
    args.refuse("is for a camera", "seconds", where=args.source is None)
    if args.source is not None:
        findings += _delivery(args.source, args.seconds)
    healthy = all(finding.status != "fail" for finding in findings)
    document = {"healthy": healthy, "checks": [finding._asdict() for finding in findings]}
    columns = ("check", "status", "found", "what to do")
    tell(args.json, document, Table("This machine", columns, findings, words=len(columns)))
    return 0 if healthy else 3  # the machine is at fault


def _libraries() -> Iterator[Finding]:
    """Yield the state of Python, and of the libraries of the package and of each extra."""
    version, cores = platform.python_version(), os.cpu_count() or 1
    yield Finding("python", "ok", f"{version} on {platform.system()}, {cores} cores")
    absent: dict[str, list[str]] = {}
    for line in metadata.requires("spikingtac") or ():
        library, extra = REQUIREMENT.fullmatch(line).groups("")  # type: ignore[union-attr]
        if extra or ";" not in line:  # what only some machines need may be absent here
            missing = absent.setdefault(extra, [])
            try:
                metadata.version(library)
            except metadata.PackageNotFoundError:
                missing.append(library)
    for extra in sorted(absent.keys() - {"dev"}):
        found = f"without {', '.join(absent[extra])}" if absent[extra] else "installed"
        todo = f"pip install 'spikingtac[{extra}]' if you need it"
        name, bad = (f"extra [{extra}]", "note") if extra else ("libraries", "fail")
        todo = todo if extra else "pip install --force-reinstall spikingtac"
        yield _judged(name, not absent[extra], found, todo, bad)


def _settings() -> Iterator[Finding]:
    """Yield what of the system's settings matters to live work."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(__file__).resolve().parents[2]
    yield _judged("kernel cache", may_hold(folder), f"{folder}", CACHE_REMEDY)
    cpus = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = {_text(path) for path in cpus} or {"not adjustable here"}
    todo = "live at 1 kHz: sudo cpupower frequency-set -g performance"
    good = governors <= {"performance", "not adjustable here"}
    yield _judged("cpu governor", good, ", ".join(sorted(governors)), todo)
    limit = _text(Path("/proc/sys/net/core/rmem_max"))
    if limit.isdecimal():
        todo = f"for udp: cameras: sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}"
        enough = int(limit) >= SOCKET_BUFFER_BYTES
        yield _judged("socket buffer", enough, f"at most {int(limit) >> 10} KiB", todo)


def _delivery(address: str, seconds: float) -> Iterator[Finding]:
    """Open a camera, and yield how it delivers.

    Raises:
        SpikingTacError: The camera cannot be opened.
    """
    given = events.Address.parse(address)
    timed = replace(given, options={**given.options, "seconds": f"{seconds:g}"})
    source = events.CameraSource(timed, events.ReadOptions())
    with ending_on_interrupt(source):
        for _ in source.columns():
            pass
    source.release()
    health = source.health()
    fast = health.interval_p50_ms is not None and health.interval_p50_ms <= LATENCY_LIMIT_MS
    found = f"{health.sentence}; {health.events / seconds / 1e6:.3f} Mev/s over {seconds:g} s"
    yield _judged("delivery", fast, found, SLOW_DELIVERY if health.events else NOTHING_CAME)
    for kind, count in health.losses.items():
        yield Finding("delivery", "note", f"{kind}: {count}")


def _judged(name: str, good: bool, found: str, remedy: str, bad: str = "note") -> Finding:
    return Finding(name, "ok", found) if good else Finding(name, bad, found, remedy)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
