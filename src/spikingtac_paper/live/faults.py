"""Faults of the live runtime: each is caused on purpose, and every event is accounted for.

The suite runs the short forms, ``spikingtac bench live`` the long ones.
"""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.errors import DeviceError
from spikingtac.events import Address, CameraSource, ReadOptions
from spikingtac.stream import EventReader, at_once, new_ring
from spikingtac_paper.live.board import EVENTS, Board, Datagrams, free_port
from spikingtac_paper.live.recording import SETTLED_S, Recording, address, lost_by_kernel
from spikingtac_paper.live.user import User

RATE_EV_S = 500_000.0  # Events per second of most faults: a skin that moves.
STEP_S = 2.0  # By how much the clock leaps, s.
SMALL_BYTES = 1 << 20  # Room of a ring that is to overrun: 0.1 million events.
DISK_BYTES = 2 << 20  # Size of the disk that runs full.


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """What became of a fault.

    Attributes:
        sent: Events that were sent.
        kept: Events that can be read, or were taken.
        lost: Events that were counted as lost or missed.
        seen: What the user is told.
        recovered: Whether events were kept that came after the fault, or where it is for good,
            whether what came before can be read.
    """

    sent: int
    kept: int
    lost: int
    seen: str
    recovered: bool

    @property
    def unaccounted(self) -> int:
        """Events that were neither kept nor counted as lost."""
        return self.sent - self.kept - self.lost


def recorded(sent: int, told: dict[str, Any], seen: str, recovered: bool = True) -> Outcome:
    """Return what became of events that were recorded."""
    lost = told["lost_events"] + lost_by_kernel(told)
    good = recovered and told["events"] == told["readable"]
    return Outcome(sent=sent, kept=told["readable"], lost=lost, seen=seen, recovered=good)


def kinds_of(told: dict[str, Any]) -> str:
    """Return what a recording has counted, in words."""
    return ", ".join(f"{kind} {count}" for kind, count in sorted(told["losses"].items()))


def unplugged(folder: Path, seconds: float) -> Outcome:
    """A camera on a serial port is unplugged, and plugged in again after a second."""
    port, sent = folder / "tty", 0

    def plug_in() -> list[int]:
        ends = list(pty.openpty())
        tty.setraw(ends[1])
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(ends[1]))
        return ends

    def speak(master: int, from_us: int) -> int:
        pieces, count, begun_s = Datagrams(), 0, time.monotonic()
        while (now_s := time.monotonic() - begun_s) < seconds / 2:
            os.write(master, pieces.at(from_us + round(now_s * 1e6)))
            count += EVENTS
            time.sleep(EVENTS / RATE_EV_S)
        time.sleep(SETTLED_S)
        return count

    ends = plug_in()
    recording = Recording(folder / "day", f"serial:{port}?encoding=evt2")
    for end in (False, True):
        sent += speak(ends[0], 10_000_000)
        if not end:
            for number in ends:
                os.close(number)
            time.sleep(1.0)
            ends = plug_in()
            time.sleep(1.0)
    told = recording.end()
    for number in ends:
        os.close(number)
    gap_s = sum(gap["t_to_us"] - gap["t_from_us"] for gap in told["gaps"]) / 1e6
    seen = f"{kinds_of(told)}; a gap of {gap_s:.1f} s in the manifest"
    return recorded(sent, told, seen, told["delivery"]["reconnects"] == 1)


def killed_user(folder: Path, seconds: float) -> Outcome:
    """One of two users of a recorded camera's ring is killed in the middle."""
    port, name = free_port(), f"killed-{os.getpid()}"
    recording = Recording(folder / "day", address(port, name))
    users = User(name), User(name)
    board = Board(port, RATE_EV_S, seconds)
    time.sleep(seconds / 2)
    users[0].process.kill()
    users[0].process.communicate()
    sent = board.sent()
    told = recording.end()
    other = users[1].counts()
    whole = other["taken"] + other["missed"] == other["published"] == told["received_events"]
    seen = (
        f"the recorder and the other user go on: {other['taken']} taken, {other['missed']} missed"
    )
    return recorded(sent, told, seen, whole)


def paused(folder: Path, seconds: float) -> Outcome:
    """A user of a shared ring, then the process that reads the camera, is paused."""
    port, name = free_port(), f"paused-{os.getpid()}"
    recording = Recording(folder / "day", address(port, name))
    user = User(name)
    board = Board(port, RATE_EV_S, 2.0 * seconds + 2.0)
    for process in (user.process, recording.process):
        time.sleep(0.5)
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)
    sent = board.sent()
    told = recording.end()
    counts = user.counts()
    whole = counts["taken"] + counts["missed"] == counts["published"] == told["received_events"]
    seen = f"user: {counts['missed']} missed; reader: {kinds_of(told) or 'nothing lost'}"
    return recorded(sent, told, seen, whole)


def overrun(folder: Path, seconds: float) -> Outcome:
    """A user is slower than the camera, in a small ring."""
    source = CameraSource(Address.parse(address(0)), ReadOptions())
    reader = EventReader.in_thread(at_once(source), source, new_ring(source.size, SMALL_BYTES))
    board = Board(source.camera.port, 10.0 * RATE_EV_S, seconds)  # type: ignore[attr-defined]
    threading.Timer(seconds + 2.0, source.close).start()
    taken = 0
    for delivery in reader:
        taken += len(delivery.packet)
        time.sleep(len(delivery.packet) / RATE_EV_S)
    lost = reader.lost_events + source.losses["overflow"] * EVENTS
    seen = f"missed {reader.lost_events}, overflow {source.losses['overflow']}"
    source.release()
    reader.release()
    recovered = reader.lost_events > 0 < taken
    return Outcome(sent=board.sent(), kept=taken, lost=lost, seen=seen, recovered=recovered)


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Yield a folder on a small disk.

    Raises:
        DeviceError: This user may not mount one.
    """
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if subprocess.run(words, capture_output=True).returncode:
        raise DeviceError("a small disk needs the right to mount one")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def disk_full(folder: Path, seconds: float) -> Outcome:
    """The disk runs full while a camera is recorded."""
    port = free_port()
    with small_disk(folder / "disk") as disk:
        recording = Recording(disk, address(port))
        board = Board(port, 2.0 * RATE_EV_S, seconds)
        recording.process.wait(seconds + 60.0)
        told = recording.end()
        sent_before = told["received_events"] + lost_by_kernel(told)
        board.sent()  # what came after the recorder's end was sent to nobody
    said = told["said"].strip().splitlines()[-1] if told["said"] else ""
    return recorded(sent_before, told, f"exit {told['code']}: {said}", told["code"] == 3)


def clock_step(folder: Path, seconds: float, step_s: float = STEP_S) -> Outcome:
    """The sensor's clock leaps while it is recorded."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    board = Board(port, RATE_EV_S, seconds, step_s=step_s)
    sent = board.sent()
    told = recording.end()
    noticed = bool(told["losses"].keys() & {"time_jump", "time_reset", "gap"})
    return recorded(sent, told, kinds_of(told), noticed)


def clock_step_back(folder: Path, seconds: float) -> Outcome:
    """The sensor's clock leaps back."""
    return clock_step(folder, seconds, -STEP_S)


Fault = Callable[[Path, float], Outcome]

# Name -> fault, and the length of its short and its long form, s.
FAULTS: dict[str, tuple[Fault, float, float]] = {
    "camera unplugged and back": (unplugged, 1.0, 20.0),
    "consumer killed": (killed_user, 1.0, 20.0),
    "disk full while recording": (disk_full, 3.0, 10.0),
    "clock leaps 2 s ahead": (clock_step, 1.0, 20.0),
    "clock leaps 2 s back": (clock_step_back, 1.0, 20.0),
    "process paused": (paused, 1.0, 5.0),
    "ring overrun": (overrun, 1.0, 20.0),
}
