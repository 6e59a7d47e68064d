"""The published detector, and its threshold from quiet windows."""

from collections.abc import Iterable

import numpy as np
import pytest

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.event_count import EventCountConfig, EventCountDetector
from spikingtac.contact.quiet import QuietStatistics
from spikingtac.types import EventPacket


def windows(counts: Iterable[int]) -> list[EventPacket]:
    out = []
    for k, count in enumerate(counts):
        zero = np.zeros(count, np.uint16)
        t = np.full(count, 1000 * k, np.int64)
        out.append(EventPacket(zero, zero, zero > 0, t, 1000 * k, 1000 * (k + 1), (320, 320)))
    return out


def test_the_first_window_above_the_threshold_is_the_contact() -> None:
    detector = EventCountDetector(EventCountConfig(threshold=5, release_windows=3))
    assert isinstance(detector, ContactDetector)
    found = [detector.update(window) for window in windows([0, 5, 6, 9, 2, 7, 0, 0, 0, 8])]
    assert [contact and contact.t_us for contact in found] == [
        None, None, 3000, None, None, None, None, None, None, 10_000,
    ]  # fmt: skip
    assert found[2] is not None
    assert (found[2].count, found[2].threshold) == (6.0, 5)
    assert detector.in_contact
    detector.reset()
    assert not detector.in_contact


def test_bursts_raise_the_threshold_and_keep_the_budget() -> None:
    rng = np.random.default_rng(1)
    size = 10.0
    counts = rng.negative_binomial(size, size / (size + 10.0), 400_000)
    quiet = QuietStatistics.of(windows(counts[:5000]))
    assert quiet.variance == pytest.approx(20.0, rel=0.1)
    budget = 3600.0  # one a second, so that a simulation of 395 s can tell
    bursty = quiet.threshold(budget)
    assert (counts[5000:] > bursty).sum() == pytest.approx(395, rel=0.35)
    calm = QuietStatistics(mean=10, variance=10, highest=25, windows=5000, period_s=1e-3)
    assert bursty > calm.threshold(budget)
