"""Work divided between two threads gives what one gives, bit by bit."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from spikingtac.state_map import two_threads
from spikingtac.state_map.two_threads import divide

SIZE, GRID = (200, 160), (4, 5)
STEPS, STEP_US, EVENTS = 12, 1_000, 600


def test_all_is_done_once_and_by_two_threads() -> None:
    done, threads, both = np.zeros(11, np.int64), set[int](), threading.Barrier(2, timeout=10.0)

    def work(some: slice) -> None:
        done[some] += 1
        if threading.get_ident() not in threads:
            threads.add(threading.get_ident())
            both.wait()

    divide(len(done), work)
    assert (done == 1).all()
    assert len(threads) == 2


def test_what_the_second_thread_cannot_begin_is_done_here() -> None:
    here, over = threading.get_ident(), threading.Event()
    blocked = two_threads._second_thread().submit(over.wait, 10.0)
    done, threads = np.zeros(8, np.int64), set[int]()

    def work(some: slice) -> None:
        done[some] += 1
        threads.add(threading.get_ident())

    divide(len(done), work)
    over.set()
    blocked.result()
    assert (done == 1).all()
    assert threads == {here}


def test_results_come_in_the_order_of_the_parts() -> None:
    assert divide(8, lambda some: (some.start, some.stop)) == [(0, 2), (2, 4), (4, 6), (6, 8)]


def test_an_error_beside_is_raised_here() -> None:
    def work(some: slice) -> None:
        if some.start:
            raise ValueError("beside")

    with pytest.raises(ValueError, match="beside"):
        divide(4, work)
