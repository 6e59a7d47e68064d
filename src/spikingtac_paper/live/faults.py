"""Faults of the live runtime: each is caused on purpose, and every event is accounted for.

The suite runs the short forms, ``spikingtac bench live`` the long ones.
"""

import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spikingtac.errors import DeviceError
from spikingtac.events import Address, CameraSource, ReadOptions
from spikingtac.stream import EventReader, at_once, new_ring
from spikingtac_paper.live.board import EVENTS, Beside, Datagrams, board, free_port, user
from spikingtac_paper.live.recording import (
    LOOK_S,
    RATE_EV_S,
    SETTLED_S,
    Outcome,
    Recording,
    address,
    kinds_of,
    lost_by_kernel,
    recorded,
    recorded_board,
    verb,
)

STEP_S = 2.0  # By how much the clock leaps, s.
SMALL_BYTES = 1 << 20  # Room of a ring that is to overrun: 0.1 million events.
DISK_BYTES = 2 << 20  # Size of the disk that runs full.
STRANGERS = 100  # Datagrams of strangers before the camera sends.
FLOOD = 4.0  # Rate of a flood over that of the camera.


def unplugged(folder: Path, seconds: float) -> Outcome:
    """A camera on a serial port is unplugged, and plugged in again after a second."""
    port, pieces, sent = folder / "tty", Datagrams(), 0
    recording: Recording | None = None
    for _ in range(2):
        master, slave = pty.openpty()
        tty.setraw(slave)
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(slave))
        if recording is None:
            recording = Recording(folder / "day", f"serial:{port}?encoding=evt2")
        time.sleep(1.0)
        begun_s = time.monotonic()
        while (now_s := time.monotonic() - begun_s) < seconds / 2:
            os.write(master, pieces.at(10_000_000 + round(now_s * 1e6)))
            sent += EVENTS
            time.sleep(EVENTS / RATE_EV_S)
        time.sleep(SETTLED_S)
        os.close(master)
        os.close(slave)
        time.sleep(1.0)
    assert recording is not None
    told = recording.end()
    gap_s = sum(gap["t_to_us"] - gap["t_from_us"] for gap in told["gaps"]) / 1e6
    seen = f"{kinds_of(told)}; a gap of {gap_s:.1f} s in the manifest"
    return recorded(sent, told, seen, told["delivery"]["reconnects"] == 1)


def _of_user(one: Beside, told: dict[str, Any]) -> tuple[str, bool]:
    """Return what a user of a recorded camera's ring tells, and whether that is all."""
    counts = one.result()
    whole = counts["taken"] + counts["missed"] == counts["published"] == told["received_events"]
    return f"user: {counts['taken']} taken, {counts['missed']} missed", whole


def killed_user(folder: Path, seconds: float) -> Outcome:
    """One of two users of a recorded camera's ring is killed in the middle."""
    port, name = free_port(), f"killed-{os.getpid()}"
    recording = Recording(folder / "day", address(port, name))
    users = user(name), user(name)
    beside = board(port, RATE_EV_S, seconds)
    time.sleep(seconds / 2)
    users[0].process.kill()
    users[0].process.communicate()
    sent = beside.result()
    told = recording.end()
    seen, whole = _of_user(users[1], told)
    return recorded(sent, told, f"the recorder and the other user go on; {seen}", whole)


def paused(folder: Path, seconds: float) -> Outcome:
    """A user of a shared ring, then the process that reads the camera, is paused."""
    port, name = free_port(), f"paused-{os.getpid()}"
    recording = Recording(folder / "day", address(port, name))
    one = user(name)
    beside = board(port, RATE_EV_S, 2.0 * seconds + 2.0)
    for process in (one.process, recording.process):
        time.sleep(0.5)
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)
    sent = beside.result()
    told = recording.end()
    seen, whole = _of_user(one, told)
    return recorded(sent, told, f"{seen}; reader: {kinds_of(told) or 'nothing lost'}", whole)


def overrun(folder: Path, seconds: float) -> Outcome:
    """A user is slower than the camera, in a small ring."""
    source = CameraSource(Address.parse(address(0)), ReadOptions())
    reader = EventReader(at_once(source), source, new_ring(source.size, SMALL_BYTES))
    beside = board(source.camera.port, 10.0 * RATE_EV_S, seconds)  # type: ignore[attr-defined]
    threading.Timer(seconds + 2.0, source.close).start()
    taken = 0
    for delivery in reader:
        taken += len(delivery.packet)
        time.sleep(len(delivery.packet) / RATE_EV_S)
    missed = reader.losses["missed"]
    lost = missed + source.losses["overflow"] * EVENTS
    seen = f"missed {missed}, overflow {source.losses['overflow']}"
    source.release()
    reader.release()
    recovered = missed > 0 < taken
    return Outcome(sent=beside.result(), kept=taken, lost=lost, seen=seen, recovered=recovered)


def disk_full(folder: Path, seconds: float) -> Outcome:
    """The disk runs full while a camera is recorded.

    Raises:
        DeviceError: This user may not mount a small disk.
    """
    port, disk = free_port(), folder / "disk"
    disk.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(disk)]
    if subprocess.run(words, capture_output=True).returncode:
        raise DeviceError("a small disk needs the right to mount one")
    try:
        recording = Recording(disk, address(port))
        beside = board(port, 2.0 * RATE_EV_S, seconds)
        recording.process.wait(seconds + 60.0)
        told = recording.end()
        beside.result()  # what came after the recorder's end was sent to nobody
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
    sent = told["received_events"] + lost_by_kernel(told)
    said = told["said"].strip().splitlines()[-1] if told["said"] else ""
    return recorded(sent, told, f"exit {told['code']}: {said}", told["code"] == 3)


def clock_step(folder: Path, seconds: float, step_s: float = STEP_S) -> Outcome:
    """The sensor's clock leaps while it is recorded."""
    sent, told = recorded_board(folder, seconds, step_s=step_s)
    noticed = bool(told["losses"].keys() & {"time_jump", "time_reset", "gap"})
    return recorded(sent, told, kinds_of(told), noticed)


def flood(folder: Path, seconds: float) -> Outcome:
    """Another sender floods the port with events of the right encoding."""
    others: list[int] = []

    def meanwhile(recording: Recording, port: int) -> None:
        time.sleep(seconds / 4)
        others.append(board(port, FLOOD * RATE_EV_S, seconds / 4).result())

    sent, told = recorded_board(folder, seconds, meanwhile)
    foreign = told["losses"].get("foreign", 0)
    seen = recorded(sent + others[0], told, kinds_of(told), foreign > 0)
    return replace(seen, lost=seen.lost + foreign * EVENTS)


def lockout(folder: Path, seconds: float) -> Outcome:
    """Strangers send empty datagrams and noise before the camera sends."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for number in range(STRANGERS):
            stranger.sendto(b"" if number % 2 else b"hello" * number, ("127.0.0.1", port))
            time.sleep(0.001)
    sent = board(port, RATE_EV_S, seconds).result()
    told = recording.end()
    heard = told["losses"].get("foreign", 0) == STRANGERS and told["events"] > 0
    return recorded(sent, told, kinds_of(told), heard)


def wrong_encoding(folder: Path, seconds: float) -> Outcome:
    """The address names another encoding than the camera sends; what came is refused."""
    _, told = recorded_board(folder, seconds, encoding="evt3")  # it ends before the board does
    manifest = json.loads((folder / "day" / "manifest.json").read_text(encoding="utf-8"))
    refused = manifest["losses"].get("foreign", 0) * EVENTS
    named = told["code"] == 1 and "encoding=evt2" in told["said"]
    seen = f"exit {told['code']}: the encoding that fits is named"
    return Outcome(sent=refused, kept=told["readable"], lost=refused, seen=seen, recovered=named)


def removed_folder(folder: Path, seconds: float) -> Outcome:
    """The folder is removed while it is recorded into."""

    def remove(recording: Recording, port: int) -> None:
        while not recording.readable:
            time.sleep(LOOK_S)
        shutil.rmtree(recording.folder)

    sent, told = recorded_board(folder, seconds, remove)
    seen = f"exit {told['code']}: events.raw was removed or changed meanwhile"
    return recorded(sent, told, seen, told["code"] == 3 and "removed" in told["said"])


def two_recorders(folder: Path, seconds: float) -> Outcome:
    """A second recorder is to replace what the first one writes."""
    second: list[subprocess.CompletedProcess[str]] = []

    def record_too(recording: Recording, port: int) -> None:
        words = verb("record", address(free_port()), "-o", str(recording.folder), "--overwrite")
        second.append(subprocess.run(words, capture_output=True, text=True))

    sent, told = recorded_board(folder, seconds, record_too)
    (done,) = second
    refused = done.returncode == 3 and "another program records" in done.stderr
    return recorded(sent, told, f"the second one: exit {done.returncode}", refused)


def killed_recorder(folder: Path, seconds: float) -> Outcome:
    """The recorder is killed: what it had taken is on disk."""
    sent, told = recorded_board(folder, seconds, end=signal.SIGKILL)
    manifest = json.loads((folder / "day" / "manifest.json").read_text(encoding="utf-8"))
    recovered = told["code"] == -signal.SIGKILL and manifest["complete"] is False
    seen = "the manifest says that it is not complete"
    return Outcome(sent=sent, kept=told["readable"], lost=0, seen=seen, recovered=recovered)


# Name -> fault or attack, and the length of its short and its long form, s.
FAULTS: dict[str, tuple[Callable[[Path, float], Outcome], float, float]] = {
    "camera unplugged and back": (unplugged, 1.0, 20.0),
    "consumer killed": (killed_user, 1.0, 20.0),
    "disk full while recording": (disk_full, 3.0, 10.0),
    "clock leaps 2 s ahead": (clock_step, 1.0, 20.0),
    "clock leaps 2 s back": (partial(clock_step, step_s=-STEP_S), 1.0, 20.0),
    "process paused": (paused, 1.0, 5.0),
    "ring overrun": (overrun, 1.0, 20.0),
    "flood by another sender": (flood, 1.0, 10.0),
    "strangers before the camera": (lockout, 1.0, 10.0),
    "wrong encoding": (wrong_encoding, 1.0, 2.0),
    "folder removed": (removed_folder, 1.0, 10.0),
    "two recorders": (two_recorders, 3.0, 10.0),
    "recorder killed": (killed_recorder, 1.0, 10.0),
}
