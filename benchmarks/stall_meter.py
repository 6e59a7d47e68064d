"""Notes when the machine itself stalls: what holds up this meter holds up every guard.

On each core a process does nothing but sleep for 1 ms, with a higher real-time priority than
anything that is measured and with its memory locked, and notes when that took longer: the host of a
virtual machine did not run the core, or the kernel did not let go of it. It shares no code path,
lock or interpreter with what is measured.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from spikingtac.live.real_time import lock_memory

PERIOD_S = 0.001
SHORTEST_S = 0.002
"""Shortest stall that is noted, s."""
PRIORITY = 50
"""Real-time priority, above a guard's."""


@dataclass(frozen=True, slots=True)
class Stall:
    """A time in which a core did not run what had to run.

    Attributes:
        end_s: When it ended, on the monotonic clock, s.
        length_s: How long it lasted, s.
        core: The core.
    """

    end_s: float
    length_s: float
    core: int


class StallNotes:
    """What the meters have noted so far.

    Args:
        folder: One file for each core.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def between(self, since_s: float, until_s: float) -> list[Stall]:
        """Return the stalls that touch a span of time, in order."""
        found: list[Stall] = []
        for path in self._folder.iterdir():
            for line in path.read_text(encoding="utf-8").splitlines():
                end_s, length_s = map(float, line.split())
                if end_s >= since_s and end_s - length_s <= until_s:
                    found.append(Stall(end_s, length_s, int(path.name)))
        return sorted(found, key=lambda stall: stall.end_s)


@contextmanager
def stall_notes() -> Iterator[StallNotes]:
    """Note stalls on every core while the context lasts. Needs permission for real-time priority.

    Raises:
        PermissionError: There is none; a meter that waits for its turn would excuse everything.
    """
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))  # raises here, not there
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        cores = sorted(os.sched_getaffinity(0))
        meters = [
            spawn.Process(target=_note_stalls, args=(core, folder), daemon=True) for core in cores
        ]
        for meter in meters:
            meter.start()
        while len(list(Path(folder).iterdir())) < len(cores):
            time.sleep(0.01)
        try:
            yield StallNotes(Path(folder))
        finally:
            for meter in meters:
                meter.terminate()
                meter.join()


def _note_stalls(core: int, folder: str) -> None:
    os.sched_setaffinity(0, {core})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    lock_memory()
    with Path(folder, str(core)).open("w", encoding="utf-8", buffering=1) as file:
        due_s = time.monotonic()
        while True:
            due_s += PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic()
            if now_s - due_s > SHORTEST_S:
                file.write(f"{now_s} {now_s - due_s}\n")
                due_s = time.monotonic()  # a disk that keeps the meter waiting is no stall
