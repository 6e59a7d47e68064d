"""SIGTERM closes what a verb has opened: an arm brakes."""

from __future__ import annotations

import contextlib
import os
import signal
import threading

import pytest

from spikingtac.cli.interrupt import EXIT_TERMINATED, ended_by_sigterm


def told_to_end(closed: list[str]) -> None:
    with ended_by_sigterm(), contextlib.ExitStack() as stack:
        stack.callback(lambda: closed.append("arm"))
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(10.0)


def test_sigterm_closes_what_was_opened() -> None:
    former, closed = signal.getsignal(signal.SIGTERM), []
    with pytest.raises(SystemExit) as ended:
        told_to_end(closed)
    assert ended.value.code == EXIT_TERMINATED
    assert closed == ["arm"]
    assert signal.getsignal(signal.SIGTERM) is former


def test_another_thread_changes_nothing() -> None:
    found = []

    def work() -> None:
        with ended_by_sigterm():
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(signal.SIGTERM)]
