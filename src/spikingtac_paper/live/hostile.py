"""Attacks on a recording: strangers, another encoding, a second recorder, a folder that goes."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

from spikingtac_paper.live.board import EVENTS, Board, free_port
from spikingtac_paper.live.faults import RATE_EV_S, Fault, Outcome, kinds_of, recorded
from spikingtac_paper.live.recording import LOOK_S, Recording, address, lost_by_kernel, verb

STRANGERS = 100  # Datagrams of strangers before the camera sends.
FLOOD = 4.0  # Rate of a flood over that of the camera.


def flood(folder: Path, seconds: float) -> Outcome:
    """Another sender floods the port with events of the right encoding."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    camera = Board(port, RATE_EV_S, seconds)
    time.sleep(seconds / 4)
    other = Board(port, FLOOD * RATE_EV_S, seconds / 4)
    sent = camera.sent() + other.sent()
    told = recording.end()
    foreign = told["losses"].get("foreign", 0)
    seen = recorded(sent, told, kinds_of(told), foreign > 0)
    lost = seen.lost + foreign * EVENTS
    return Outcome(sent=sent, kept=seen.kept, lost=lost, seen=seen.seen, recovered=seen.recovered)


def lockout(folder: Path, seconds: float) -> Outcome:
    """Strangers send empty datagrams and noise before the camera sends."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for number in range(STRANGERS):
            stranger.sendto(b"" if number % 2 else b"hello" * number, ("127.0.0.1", port))
            time.sleep(0.001)
    sent = Board(port, RATE_EV_S, seconds).sent()
    told = recording.end()
    heard = told["losses"].get("foreign", 0) == STRANGERS and told["events"] > 0
    return recorded(sent, told, kinds_of(told), heard)


def wrong_encoding(folder: Path, seconds: float) -> Outcome:
    """The address names another encoding than the camera sends; what came is refused."""
    port = free_port()
    recording = Recording(folder / "day", address(port, encoding="evt3"))
    Board(port, RATE_EV_S, seconds).sent()  # after the recorder's end it speaks to nobody
    told = recording.end()
    manifest = json.loads((folder / "day" / "manifest.json").read_text(encoding="utf-8"))
    refused = manifest["losses"].get("foreign", 0) * EVENTS
    named = told["code"] == 1 and "encoding=evt2" in told["said"]
    seen = f"exit {told['code']}: the encoding that fits is named"
    return Outcome(sent=refused, kept=told["readable"], lost=refused, seen=seen, recovered=named)


def removed_folder(folder: Path, seconds: float) -> Outcome:
    """The folder is removed while it is recorded into."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    board = Board(port, RATE_EV_S, seconds)
    while not recording.readable:
        time.sleep(LOOK_S)
    shutil.rmtree(folder / "day")
    board.sent()  # what came after the recorder's end was sent to nobody
    told = recording.end()
    sent = told["received_events"] + lost_by_kernel(told)
    seen = f"exit {told['code']}: events.raw was removed or changed meanwhile"
    return recorded(sent, told, seen, told["code"] == 3 and "removed" in told["said"])


def two_recorders(folder: Path, seconds: float) -> Outcome:
    """A second recorder is to replace what the first one writes."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    board = Board(port, RATE_EV_S, seconds)
    words = verb("record", address(free_port()), "-o", str(folder / "day"), "--overwrite")
    second = subprocess.run(words, capture_output=True, text=True)
    sent = board.sent()
    told = recording.end()
    refused = second.returncode == 3 and "another program records" in second.stderr
    return recorded(sent, told, f"the second one: exit {second.returncode}", refused)


def killed_recorder(folder: Path, seconds: float) -> Outcome:
    """The recorder is killed: what it had taken is on disk."""
    port = free_port()
    recording = Recording(folder / "day", address(port))
    sent = Board(port, RATE_EV_S, seconds).sent()
    told = recording.end(signal.SIGKILL)
    manifest = json.loads((folder / "day" / "manifest.json").read_text(encoding="utf-8"))
    recovered = told["code"] == -signal.SIGKILL and manifest["complete"] is False
    seen = "the manifest says that it is not complete"
    return Outcome(sent=sent, kept=told["readable"], lost=0, seen=seen, recovered=recovered)


# Name -> attack, and the length of its short and its long form, s.
ATTACKS: dict[str, tuple[Fault, float, float]] = {
    "flood by another sender": (flood, 1.0, 10.0),
    "strangers before the camera": (lockout, 1.0, 10.0),
    "wrong encoding": (wrong_encoding, 1.0, 2.0),
    "folder removed": (removed_folder, 1.0, 10.0),
    "two recorders": (two_recorders, 3.0, 10.0),
    "recorder killed": (killed_recorder, 1.0, 10.0),
}
