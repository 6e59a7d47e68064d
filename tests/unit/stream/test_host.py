"""A function in a process of its own: what it tells, what it raises, and that it ends."""

import atexit
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from spikingtac.errors import DeviceError
from spikingtac.stream.host import Asker, Host, end_in_order
from stand_ins.waiting import wait_until

PATIENCE_S = 60.0


def echo(asker: Asker, word: str) -> None:
    asker.tell(word)
    while not (said := asker.said()):
        time.sleep(0.001)
    asker.tell(said[0])


def fail(asker: Asker) -> None:
    end_in_order()
    atexit.register(time.sleep, 0.5)  # it is closed while it ends
    raise DeviceError("there is no such camera")


def endless(asker: Asker) -> None:
    asker.tell(os.getpid())
    time.sleep(600.0)


def test_what_is_told_goes_both_ways() -> None:
    host = Host("the echo", partial(echo, word="here"))
    assert host.receive(PATIENCE_S) == "here"
    assert host.tell("there")
    assert host.receive(PATIENCE_S) == "there"
    with pytest.raises(EOFError):
        host.receive(PATIENCE_S)
    assert host.wait(PATIENCE_S)
    assert not host.tell("nobody")
    host.close()


def test_an_error_is_raised_here_and_a_kill_is_known(capfd: pytest.CaptureFixture[str]) -> None:
    failing = Host("the camera", fail)
    with pytest.raises(DeviceError, match="no such camera"):
        failing.receive(PATIENCE_S)
    time.sleep(0.2)
    failing.close()
    assert capfd.readouterr().err == ""
    host = Host("the sleeper", endless)
    assert host.receive(PATIENCE_S) == host.pid
    host.kill()
    with pytest.raises(DeviceError, match="the sleeper was killed"):
        host.receive(PATIENCE_S)
    assert not host.alive()
    host.close()


SCRIPT = """
import sys, time
sys.path[:0] = {tests!r}
from test_host import Host, endless
host = Host("the sleeper", endless)
print(host.receive(60.0), flush=True)
time.sleep(600.0)
"""


def test_a_flat_script_that_is_killed_leaves_no_process() -> None:
    """Nothing guards the script's main part: it is never imported a second time."""
    script = SCRIPT.format(tests=[str(Path(__file__).parents[n]) for n in (0, 2)])
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    line = Path(f"/proc/{int(process.stdout.readline())}/cmdline")
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    wait_until(lambda: not line.exists() or not line.read_bytes())  # ended, maybe not reaped
