"""What a guard asks of the system is given, or refused without harm."""

import subprocess
import sys
from pathlib import Path

import pytest


def test_what_was_there_before_the_watch_is_not_visited_by_collections() -> None:
    """A collection of everything stops all threads for longer than the watchdog waits."""
    script = (
        "import gc, numpy\n"
        "from spikingtac.live.guard.real_time import exempt_from_collection\n"
        "before = len(gc.get_objects())\n"
        "exempt_from_collection()\n"
        "print(before, len(gc.get_objects()))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    before, after = map(int, done.stdout.split())
    assert after < 100 < before


def test_memory_is_kept_in_place_where_that_is_permitted() -> None:
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("this system does not tell how much memory is locked")
    script = (
        "from pathlib import Path\n"
        "from spikingtac.live.guard.real_time import lock_memory\n"
        "given = lock_memory()\n"
        f"lines = Path({str(status)!r}).read_text().splitlines()\n"
        "print(int(given), *[line.split()[1] for line in lines if line.startswith('VmLck')])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    given, locked_kb = map(int, done.stdout.split())
    assert (locked_kb > 0) == bool(given)
