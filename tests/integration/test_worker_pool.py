import os
import signal
import subprocess
import sys
import time

import pytest

from spikingtac.batch.worker_pool import cpu_count, worker_pool

pytestmark = pytest.mark.waits

ORPHANAGE = """
import os, sys, time
from spikingtac.batch.worker_pool import worker_pool

if __name__ == "__main__":
    with worker_pool(2, 2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(cpu_count() < 2, reason="a pool of one is a thread of its process")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_the_experiment(tmp_path, how):
    script = tmp_path / "orphanage.py"
    script.write_text(ORPHANAGE, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    assert worker != parent.pid
    assert alive(worker)
    parent.send_signal(how)
    parent.wait(timeout=30)
    parent.stdout.close()
    deadline = time.monotonic() + 30
    while alive(worker):
        assert time.monotonic() < deadline, f"worker {worker} goes on"
        time.sleep(0.05)


def test_one_worker_is_this_process():
    with worker_pool(1, 5) as pool:
        assert pool.submit(os.getpid).result() == os.getpid()


def test_what_was_not_begun_is_dropped():
    with pytest.raises(KeyboardInterrupt), worker_pool(1, 5) as pool:  # noqa: PT012
        pool.submit(time.sleep, 0.5)
        later = pool.submit(time.sleep, 600)
        raise KeyboardInterrupt
    assert later.cancelled()
