"""What a guard asks of the system is given, or refused without harm."""

import os
import subprocess
import sys

import pytest

from spikingtac.stream import real_time


def test_what_was_there_before_the_watch_is_not_visited_by_collections() -> None:
    """A collection of everything stops all threads for longer than the watchdog waits."""
    script = (
        "import gc, numpy\n"
        "from spikingtac.stream.real_time import exempt_from_collection\n"
        "before = len(gc.get_objects())\n"
        "exempt_from_collection()\n"
        "print(before, len(gc.get_objects()))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    before, after = map(int, done.stdout.split())
    assert after < 100 < before


def test_children_end_at_ordinary_priority_and_what_was_granted_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    has: list[tuple[int, int]] = [(1, 20)]
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: has[-1][0], raising=False)
    monkeypatch.setattr(os, "sched_getparam", lambda _: has[-1][1], raising=False)
    monkeypatch.setattr(os, "sched_param", int, raising=False)
    monkeypatch.setattr(os, "SCHED_OTHER", 0, raising=False)

    def give(_: int, policy: int, param: int) -> None:
        has.append((policy, param))

    monkeypatch.setattr(os, "sched_setscheduler", give, raising=False)

    @real_time.ordinary_priority()
    def fail() -> None:
        assert has[-1] == (0, 0)
        raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert has == [(1, 20), (0, 0), (1, 20)]
