"""Checks of what a camera needs of this machine, and how one delivers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from spikingtac.cli.system.finding import Finding

SOCKET_BUFFER_BYTES = 8 << 20
"""Buffer that a camera's datagrams ask for (``cameras/udp.py``): 0.7 s at 3 Mev/s."""
_SOCKET_LIMIT = Path("/proc/sys/net/core/rmem_max")
_CLOCK = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies")
"""Clock sources that cost a microsecond or more for each look at the time."""
_TTY = Path("/dev")
LATENCY_LIMIT_MS = 1.0
"""Interval of deliveries from which on a window of 1 ms is no latency of 1 ms."""


def camera_checks() -> Iterator[Finding]:
    """Yield what was found of libraries, ports, sockets and clock."""
    yield from _libraries()
    yield from _ports()
    yield from _socket_buffer()
    yield from _clock()


def delivery(address: str, seconds: float) -> Iterator[Finding]:
    """Open a camera, and yield how it delivers.

    Args:
        address: The camera's.
        seconds: How long to listen, s.

    Raises:
        SpikingTacError: The camera cannot be opened.
    """
    from spikingtac.cli.interrupt import ending_on_interrupt
    from spikingtac.events.address import Address
    from spikingtac.events.cameras.source import CameraSource
    from spikingtac.events.formats.file_source import ReadOptions

    given = Address.parse(address)
    options = {**given.options, "seconds": f"{seconds:g}"}
    timed = Address(kind=given.kind, target=given.target, options=options)
    source = CameraSource(timed, ReadOptions())
    with ending_on_interrupt(source):
        for _ in source.columns():
            pass
    source.release()
    health = source.health()
    rate = health.events / seconds
    slow = health.interval_p50_ms is None or health.interval_p50_ms > LATENCY_LIMIT_MS
    yield Finding(
        name="delivery",
        status="note" if slow else "ok",
        found=f"{health.sentence}; {rate / 1e6:.3f} Mev/s over {seconds:g} s",
        remedy=SLOW_DELIVERY if slow and health.events else NOTHING_CAME if slow else "",
    )
    for kind, count in health.losses.items():
        yield Finding(name="delivery", status="note", found=f"{kind}: {count}")


SLOW_DELIVERY = (
    "ask the maker's driver for smaller transfers (openmv: words=1024; OpenEB's kernel driver: "
    "mipi_frame_period)"
)
NOTHING_CAME = "see that the camera is on, its address is right, and something moves before it"


def _libraries() -> Iterator[Finding]:
    from spikingtac.cameras.found import is_installed, remedy
    from spikingtac.events.cameras.kinds import KINDS

    for name, kind in KINDS.items():  # those of extras are told with the extras
        if kind.module and not kind.extra:
            here = is_installed(name)
            yield Finding(
                name="camera library",
                status="ok" if here else "note",
                found=f"{kind.about}: {'installed' if here else 'not installed'}",
                remedy="" if here else f"{remedy(name)} if you have one",
            )


def _ports() -> Iterator[Finding]:
    for path in sorted([*_TTY.glob("ttyACM*"), *_TTY.glob("video*")]):
        if not os.access(path, os.R_OK | os.W_OK):
            group = "video" if path.name.startswith("video") else "dialout"
            todo = f"sudo usermod -aG {group} $USER, then log in again"
            found = f"{path} may not be opened by you"
            yield Finding(name="permissions", status="note", found=found, remedy=todo)


def _socket_buffer() -> Iterator[Finding]:
    try:
        limit = int(_SOCKET_LIMIT.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return
    if limit >= SOCKET_BUFFER_BYTES:
        yield Finding(name="socket buffer", status="ok", found=f"up to {limit >> 10} KiB")
        return
    yield Finding(
        name="socket buffer",
        status="note",
        found=f"at most {limit >> 10} KiB: datagrams of a fast camera overrun it",
        remedy=f"for udp: cameras: sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}",
    )


def _clock() -> Iterator[Finding]:
    try:
        source = _CLOCK.read_text(encoding="ascii").strip()
    except OSError:
        return
    slow = source in SLOW_CLOCKS
    yield Finding(
        name="clock",
        status="note" if slow else "ok",
        found=f"the kernel's clock is {source}" + (", which is slow to read" if slow else ""),
        remedy="choose tsc in the machine's settings or kernel options" if slow else "",
    )
