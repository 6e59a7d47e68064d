"""What lets a guard run when it has to: precedence, memory that stays, no garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
from pathlib import Path

PRIORITY = 10
"""Real-time priority of the guard, 1 to 99 (ours: above ordinary work, below drivers)."""
LOCK_CURRENT, LOCK_FUTURE = 1, 2
"""Flags of mlockall (sys/mman.h of Linux)."""
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

    Its memory stays in place as well, where that is permitted: a page that has to come back from
    the disk takes as long as a turn.

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
    lock_memory()
    return True


def lock_memory() -> bool:
    """Keep all memory of this process in place, now and later; return whether that is permitted.

    Permission: root, or a line for the user in /etc/security/limits.conf (``memlock``).
    """
    try:
        return ctypes.CDLL(None).mlockall(LOCK_CURRENT | LOCK_FUTURE) == 0
    except (AttributeError, OSError):  # no such system
        return False
