"""What lets a guard run when it has to: precedence, memory that stays, no garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
from pathlib import Path

PRIORITY = 10
"""Real-time priority of the guard, 1 to 99 (ours: above ordinary work, below drivers)."""
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4
"""Flags of mlockall (sys/mman.h of Linux). Without the last one every library is read from the disk
as a whole, and every new thread's stack is filled, while nothing else runs: 0.1 s and more."""
THREADS = Path("/proc/self/task")
"""Where Linux lists the threads of this process."""


def exempt_from_collection() -> None:
    """Exempt what is there by now from garbage collection; to be called before an arm is connected.

    A collection visits everything that was imported and stops all threads meanwhile (measured: 170
    to 230 ms on a busy machine, beside Numba and SciPy), longer than any watchdog waits.
    """
    gc.collect()
    gc.freeze()


def take_precedence() -> bool:
    """Let this process run before ordinary work, where that is permitted; return whether it is.

    Within 25 ms, which is when a watchdog trips, a busy machine may not give an ordinary thread its
    turn. All threads take part: one that waits for its turn while it holds the interpreter would
    hold up the others. Permission: root, or a line for the user in /etc/security/limits.conf
    (``rtprio``).
    """
    try:
        for thread in [0, *(int(path.name) for path in THREADS.iterdir())]:  # 0: this one
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):  # no such system, or not permitted
        return False
    return True


def lock_memory() -> bool:
    """Keep what memory is used in place, now and later; return whether that is permitted.

    Permission: root, or a line for the user in /etc/security/limits.conf (``memlock``). A
    page that has to come back from the disk takes as long as a busy machine's turn.
    """
    try:
        return ctypes.CDLL(None).mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT) == 0
    except (AttributeError, OSError):  # no such system
        return False
