"""``spikingtac record`` of a board's events, run as a user runs it, and what it tells."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikingtac.events import open_events
from spikingtac_paper.live.board import EVENTS, SIZE, board, free_port

PATIENCE_S = 120.0  # Longest wait for the verb, s: it may compile first.
LOOK_S = 0.02
RATE_EV_S = 500_000.0  # Events per second of most faults: a skin that moves.
SETTLED_S = 0.5  # Time in which a recorder takes some of what waits for it, s.


def verb(*words: str) -> list[str]:
    """Return the command line of a verb."""
    code = "from spikingtac.cli.main import main; import sys; sys.exit(main())"
    return [sys.executable, "-c", code, *words]


class Recording:
    """A recording in a process of its own.

    Args:
        folder: Where to record.
        address: The camera's.
    """

    def __init__(self, folder: Path, address: str) -> None:
        self.folder = folder
        found = re.match(r"udp:127.0.0.1:(\d+)", address)
        self._port = f":{int(found[1]):04X}" if found else ""
        words = verb("record", address, "-o", str(folder), "--json")
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True)
        until_s = time.monotonic() + PATIENCE_S
        while not (folder / "manifest.json").exists():
            if self.process.poll() is not None or time.monotonic() > until_s:
                raise RuntimeError(f"no recording: {self.process.communicate()}")
            time.sleep(LOOK_S)

    def end(self, number: int = signal.SIGINT) -> dict[str, Any]:
        """End it by a signal, and return its summary with the exit code and the memory."""
        self._settle()
        peak_mb = 0.0
        if self.process.poll() is None:
            status = Path(f"/proc/{self.process.pid}/status").read_text()
            peak_mb = int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) / 1024
            os.kill(self.process.pid, number)
        out, error = self.process.communicate(timeout=PATIENCE_S)
        told = json.loads(out) if out.strip() else {}
        readable = sum(map(len, open_events(self.folder))) if self.readable else 0
        found = {"code": self.process.returncode, "said": error, "peak_mb": peak_mb}
        return {**told, **found, "readable": readable}

    def _settle(self) -> None:
        """Wait until nothing waits in the kernel, and the files grow no more."""
        while self._port and self._waits():
            time.sleep(LOOK_S)
        before = -1
        while (now := sum(path.stat().st_size for path in self.folder.glob("*.raw"))) != before:
            before = now
            time.sleep(SETTLED_S)

    def _waits(self) -> bool:
        """Return whether datagrams wait for the port to be read."""
        sockets = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        queued = [words[4].split(":")[1] for words in sockets if words[1].endswith(self._port)]
        return any(int(length, 16) for length in queued) and self.process.poll() is None

    @property
    def readable(self) -> bool:
        """Whether there is anything to read."""
        file = self.folder / "events.raw"
        return file.is_file() and file.stat().st_size > 0


def address(port: int, share: str = "", encoding: str = "evt2") -> str:
    """Return a board's address."""
    text = f"udp:127.0.0.1:{port}?encoding={encoding}&size={SIZE[0]}x{SIZE[1]}"
    return f"{text}&share={share}" if share else text


def lost_by_kernel(told: dict[str, Any]) -> int:
    """Return the events in datagrams that the kernel has dropped, and was seen to drop."""
    return told.get("losses", {}).get("overflow", 0) * EVENTS


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


def recorded_board(
    folder: Path,
    seconds: float,
    meanwhile: Callable[[Recording, int], object] = lambda recording, port: None,
    *,
    step_s: float = 0.0,
    end: int = signal.SIGINT,
    encoding: str = "evt2",
) -> tuple[int, dict[str, Any]]:
    """Record a board's events, and return how many it has sent and what the recorder tells.

    Args:
        folder: Where.
        seconds: How long the board sends, s.
        meanwhile: Called with the recorder and the port while the board sends.
        step_s: By how much the board's clock leaps in the middle, s.
        end: Signal that ends the recorder.
        encoding: Of the address.
    """
    port = free_port()
    recording = Recording(folder / "day", address(port, encoding=encoding))
    beside = board(port, RATE_EV_S, seconds, step_s=step_s)
    meanwhile(recording, port)
    sent = beside.result()
    return sent, recording.end(end)
