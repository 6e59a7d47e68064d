import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spikingtac.types import EventPacket
from spikingtac.viewer.replay import event_store
from spikingtac.viewer.replay.event_store import EventStore
from stand_ins.live import SIZE, random_packets, random_source


@pytest.mark.parametrize("capacity", [1, 7, 1 << 20])
def test_any_stretch_equals_the_source(capacity: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_store, "FIRST_CAPACITY", capacity)
    whole = EventPacket.concatenate(random_packets(1, 20))
    store = EventStore(random_source(1, 20))
    store.extend_to_end()
    assert len(store) == len(whole)
    for start_us, end_us in [(0, 10**9), (5_000, 5_001), (17_123, 90_001), (300_000, 400_000)]:
        part = store.between(start_us, end_us)
        inside = (whole.t >= start_us) & (whole.t < end_us)
        for name in ("x", "y", "p", "t"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[inside])
        assert (part.t_start_us, part.t_end_us, part.size) == (start_us, end_us, SIZE)
    store.close()


def test_a_source_is_pulled_no_further_than_needed() -> None:
    store = EventStore(random_source(1, 20))
    assert store.extend_to(12_000)
    assert store.t_end_us == 15_000
    assert not store.extend_to(10**9)
    assert store.ended


LEFT_BEHIND = """
import os, signal, sys
sys.path.insert(0, {tests!r})
from spikingtac.viewer.replay.event_store import EventStore
from stand_ins.live import random_source
store = EventStore(random_source(1, 20))
store.extend_to_end()
assert len(store.between(0, 10**9)) == len(store) > 0
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_nothing_is_left_of_a_process_that_was_killed(tmp_path: Path) -> None:
    code = LEFT_BEHIND.format(tests=str(Path(__file__).parents[2]))
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "TMPDIR": str(tmp_path)}, timeout=120
    )
    assert done.returncode == -signal.SIGKILL
    assert list(tmp_path.iterdir()) == []
