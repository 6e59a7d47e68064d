"""Work divided between two threads gives what one gives, bit by bit."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.markers.registry import make_tracker
from spikingtac.state_map import two_threads
from spikingtac.state_map.two_threads import divide, worth_dividing
from spikingtac.types import EventPacket, MarkerFrame

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


def test_one_core_divides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_threads, "_cores", lambda: 1)
    assert not worth_dividing(1_000_000, 1)
    monkeypatch.setattr(two_threads, "_cores", lambda: 2)
    assert worth_dividing(256, 256)
    assert not worth_dividing(255, 256)


@pytest.mark.parametrize("preset", ["default", "fast"])
def test_tracks_are_the_same_with_two_threads(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_threads, "_cores", lambda: 1)
    alone = tracked(preset)
    monkeypatch.setattr(two_threads, "_cores", lambda: 2)
    for module in ("markers.graded.disc_locator.MANY_MARKERS", "state_map.graded.MANY_EVENTS"):
        monkeypatch.setattr(f"spikingtac.{module}", 2)
    monkeypatch.setattr("spikingtac.markers.graded.event_loss.MANY_EVENTS", 2)
    for one, two in zip(alone, tracked(preset), strict=True):
        np.testing.assert_array_equal(one.detected_px, two.detected_px)
        np.testing.assert_array_equal(one.confidence, two.confidence)


def tracked(preset: str) -> list[MarkerFrame]:
    """Track events all over the discs' edges."""
    rows, columns = GRID
    y, x = np.mgrid[0:rows, 0:columns].reshape(2, -1) * 40.0 + 18.3
    calibration = Calibration(
        reference_px=np.column_stack([x, y]),
        radius_px=np.full(rows * columns, 8.0),
        grid=GRID,
        size=SIZE,
    )
    tracker, rng = make_tracker(load_config(preset).tracking, calibration), np.random.default_rng(3)
    frames = []
    for step in range(STEPS):
        marker, angle = rng.integers(0, rows * columns, EVENTS), rng.uniform(0.0, 2 * np.pi, EVENTS)
        begin_us = step * STEP_US
        packet = EventPacket(
            np.clip(x[marker] + 8.0 * np.cos(angle), 0, SIZE[0] - 1).astype(np.uint16),
            np.clip(y[marker] + 8.0 * np.sin(angle), 0, SIZE[1] - 1).astype(np.uint16),
            np.cos(angle) > 0.0,
            np.sort(rng.integers(begin_us, begin_us + STEP_US, EVENTS)),
            begin_us,
            begin_us + STEP_US,
            SIZE,
        )
        tracker.absorb(packet)
        frames.append(tracker.estimate(begin_us + STEP_US))
    assert np.ptp([frame.detected_px for frame in frames], axis=0).max() > 0.05
    return frames
