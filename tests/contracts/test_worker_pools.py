"""What worker processes must do: try again, end at once, and never outlive their parent."""

import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.queues import Queue
from pathlib import Path

import pytest

from spikingtac.atomic_files import runs
from spikingtac.batch.worker_pool import ATTEMPTS, worker_pool
from spikingtac.errors import DeviceError
from stand_ins.waiting import wait_until

pytestmark = pytest.mark.waits

ORPHANAGE = """
import os, sys, time
from spikingtac.batch.worker_pool import worker_pool

if __name__ == "__main__":
    with worker_pool(1, 2, isolated=True) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""


def die(marker: str, times: int) -> str:
    """Kill the own process, so many times."""
    path = Path(marker)
    deaths = len(path.read_text()) if path.exists() else 0
    if deaths < times:
        path.write_text("x" * (deaths + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def test_a_task_whose_worker_dies_is_tried_again_and_then_given_up(tmp_path: Path) -> None:
    with worker_pool(1, 3, isolated=True) as pool:
        once = pool.submit(die, str(tmp_path / "once"), ATTEMPTS - 1)
        always = pool.submit(die, str(tmp_path / "always"), ATTEMPTS)
        after = pool.submit(divmod, 9, 4)
        assert once.result() == "alive"
        with pytest.raises(DeviceError, match="killed 2 times"):
            always.result()
        assert after.result() == (2, 1)


def test_what_is_given_up_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Queue, "join_thread", lambda queue: time.sleep(0.3))  # ends slowly
    begun_s, threads = time.monotonic(), threading.active_count()
    with pytest.raises(KeyboardInterrupt), worker_pool(1, 5, isolated=True) as pool:  # noqa: PT012
        pid = pool.submit(os.getpid).result()
        working, later = (pool.submit(time.sleep, 600) for _ in range(2))
        wait_until(working.running)
        raise KeyboardInterrupt
    assert later.cancelled()
    assert time.monotonic() - begun_s < 60
    assert threading.active_count() <= threads
    wait_until(lambda: not runs(pid))


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_its_parent(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "orphanage.py"
    script.write_text(ORPHANAGE, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    parent.send_signal(how)
    parent.wait(timeout=30)
    parent.stdout.close()
    wait_until(lambda: not runs(worker))
