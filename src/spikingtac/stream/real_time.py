"""What lets a process run when it has to: precedence, a core, memory that stays, no collection."""

import ctypes
import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# Real-time priorities, 1 to 99 (above ordinary work, below drivers; what guards an arm runs
# before a tracker or a display on the same core).
PRIORITY, GUARD_PRIORITY = 10, 20

# Flags of mlockall (sys/mman.h of Linux). Without the last one every library is read from the
# disk as a whole, and every new thread's stack is filled, while nothing else runs: 0.1 s and
# more.
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4

# Where an administrator permits priority and locked memory to a user.
LIMITS = "/etc/security/limits.conf"
THREADS = Path("/proc/self/task")  # Where Linux lists the threads of this process.


def meet_deadlines() -> str:
    """Request all measures that the system permits, and return in words what was granted.

    To be called before the stream begins. A process that is refused all of it works as before, and
    so does one on another system than Linux. What it has started before keeps its own priority and
    cores. It keeps to one core only with priority: without, it would wait there for whatever else
    runs, while another core is free.
    """
    exempt_from_collection()
    memory = "locked" if lock_memory() else f"not locked (memlock in {LIMITS})"
    precedes = take_precedence()
    priority = "real-time" if precedes else f"ordinary (rtprio in {LIMITS})"
    core = keep_to_one_core() if precedes else None
    where = "any core" if core is None else f"core {core} alone"
    return f"real time: memory {memory}, priority {priority}, {where}, no garbage collection"


def exempt_from_collection() -> None:
    """Exempt what is there by now from garbage collection; to be called before an arm is connected.

    A collection visits everything that was imported and stops all threads meanwhile (measured: 170
    to 230 ms on a busy machine, beside Numba and SciPy), longer than any watchdog waits.
    """
    gc.collect()
    gc.freeze()


def take_precedence(priority: int = PRIORITY) -> bool:
    """Let this process run before ordinary work, where that is permitted; return whether it is.

    Within 40 ms, which is when a watchdog trips, a busy machine may not give an ordinary thread its
    turn. All threads take part: one that waits for its turn while it holds the interpreter would
    hold up the others. Permission: root, or a line for the user in /etc/security/limits.conf
    (``rtprio``); who is permitted less than is asked for has :data:`PRIORITY`.
    """
    for wanted in (priority, PRIORITY):
        with suppress(AttributeError, OSError):  # no such system, or not permitted
            for thread in [0, *(int(path.name) for path in THREADS.iterdir())]:  # 0: this one
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(wanted))
            return True
    return False


@contextmanager
def ordinary_priority() -> Iterator[None]:
    """Let this thread be ordinary work meanwhile; also a decorator. For what ends child processes.

    The kernel removes an ended child from /proc in a loop that lasts as long as some program looks
    at it there. With priority the loop may keep that program from the core: seen for 24 minutes.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except (AttributeError, OSError):  # another system than Linux
        yield
        return
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, *before)


def keep_to_one_core() -> int | None:
    """Keep Python's threads to the last core that this process may use; return it, or None.

    A thread that moves to another core finds none of its data in that core's cache; the first core
    serves most interrupts. Threads of libraries stay free: OpenBLAS waits for its own without
    letting go of the core, so that on one core and with priority it would wait for ever.
    """
    with suppress(AttributeError, OSError):  # no such system, or a thread that has ended
        cores = os.sched_getaffinity(0)
        if len(cores) >= 2:
            for thread in [0, *(one.native_id for one in threading.enumerate() if one.native_id)]:
                os.sched_setaffinity(thread, {max(cores)})  # 0: this one
            return max(cores)
    return None


def lock_memory() -> bool:
    """Keep what memory is used in place, now and later; return whether that is permitted.

    Permission: root, or a line for the user in /etc/security/limits.conf (``memlock``). A
    page that has to come back from the disk takes as long as a busy machine's turn.
    """
    try:
        return ctypes.CDLL(None).mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT) == 0
    except (AttributeError, OSError):  # no such system
        return False
