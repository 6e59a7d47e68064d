"""The swing in events, on discs that are swept by hand."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.touch.ageing import LONGEST_GAP_US, SwingRuns
from spikingtac.types import EventPacket

SIZE = (140, 140)
X, Y = np.meshgrid(np.arange(3.0), np.arange(3.0))
CENTERS = 40.0 * np.column_stack([X.ravel(), Y.ravel()]) + 30.0
CALIBRATION = Calibration(
    reference_px=CENTERS, radius_px=np.full(9, 6.5), grid=(3, 3), size=SIZE,
    step_on=1.0 / 8.0, step_off=1.0 / 6.0,
)  # fmt: skip


def swept(on: int, off: int, gap_us: int = 1_000, start_us: int = 0) -> EventPacket:
    """Every rim pixel brightens by ``on`` events and darkens again by ``off``."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    away = np.min([np.hypot(x - cx, y - cy) for cx, cy in CENTERS], axis=0)
    rows, columns = np.nonzero(np.abs(away - 6.5) < 2.5)
    polarity = [True] * on + [False] * off
    t = start_us + gap_us * np.repeat(np.arange(len(polarity)), len(rows))
    p = np.repeat(polarity, len(rows))
    tile = np.tile(np.stack([columns, rows]), len(polarity)).astype(np.uint16)
    return EventPacket(
        tile[0], tile[1], p, t.astype(np.int64), start_us, int(t[-1]) + 1, SIZE, checked=True
    )


def watched(*packets: EventPacket, moved_px: float = 6.0) -> SwingRuns:
    runs = SwingRuns(CALIBRATION)
    for packet in packets:
        runs.absorb(packet)
    runs.follow(np.full((9, 2), [moved_px, 0.0]))
    runs.follow(np.zeros((9, 2)))  # it came back, and is remembered
    return runs


def test_a_faded_gel_is_told_with_what_to_do() -> None:
    found = watched(swept(6, 4)).swing()
    assert found is not None
    assert found.share == pytest.approx(0.5 * (6 / 8 + 4 / 6))
    assert found.faded
    assert "71 %" in found.words()
    assert "calibrate again" in found.words()


def test_small_motions_and_few_markers_say_nothing() -> None:
    assert watched(swept(3, 2), moved_px=3.0).swing() is None
    runs = SwingRuns(CALIBRATION)
    runs.absorb(swept(8, 6))
    far = np.zeros((9, 2))
    far[:7] = 6.0
    runs.follow(far)
    assert runs.swing() is None


def test_the_leak_of_a_resting_pixel_makes_no_run() -> None:
    slow = swept(30, 0, gap_us=LONGEST_GAP_US + 1)
    found = watched(slow, swept(8, 6, start_us=slow.t_end_us + LONGEST_GAP_US + 1)).swing()
    assert found is not None
    assert found.share == pytest.approx(1.0)


def test_the_packing_does_not_matter() -> None:
    whole = swept(8, 6)
    middle = len(whole) // 3
    parts = (
        whole.part(0, middle, 0, int(whole.t[middle])),
        whole.part(middle, len(whole), int(whole.t[middle]), whole.t_end_us),
    )
    assert watched(*parts).swing() == watched(whole).swing()


def test_another_sensor_is_refused() -> None:
    with pytest.raises(ConfigError):
        SwingRuns(CALIBRATION).absorb(EventPacket.empty(0, 1, (10, 10)))
