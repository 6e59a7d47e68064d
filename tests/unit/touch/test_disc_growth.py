"""Growth of the discs from events that were made by hand: no camera, no calibration run."""

import dataclasses

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.touch.indentation.disc_growth import DiscGrowthConfig, DiscGrowthGauge
from spikingtac.touch.indentation.resting_discs import edge_level, why_no_growth
from spikingtac.types import EventPacket

PITCH, STEP, FRAME_US = 37.0, 0.1, 10_000
PLACES = PITCH * np.array([[x, y] for y in (0.6, 1.6) for x in (0.6, 1.6)])
CALIBRATION = Calibration(
    reference_px=PLACES,
    radius_px=np.full(4, 7.0),
    grid=(2, 2),
    size=(84, 84),
    contrast=6.0,
    edge_px=0.5,
    step_on=STEP,
    step_off=STEP,
)


def painted(places: np.ndarray, growth: float) -> np.ndarray:
    rows, columns = np.mgrid[:84, :84]
    level = np.zeros((84, 84))
    for x, y in places:
        away = np.hypot(columns - x, rows - y)
        level = np.maximum(level, edge_level(away - 7.0 * (1.0 + growth), 6.0, 0.5))
    return level


class Skin:
    """Pixels that give an event for each step that their level has left the last one's by."""

    def __init__(self) -> None:
        self.last, self.t_us = painted(PLACES, 0.0), 0

    def go(self, places: np.ndarray, growth: float) -> EventPacket:
        away = painted(places, growth) - self.last
        count = np.trunc(away / STEP).astype(int)
        self.last = self.last + STEP * count
        y, x = (np.repeat(axis, np.abs(count).ravel()) for axis in np.indices(count.shape).reshape(2, -1))
        on = np.repeat((count > 0).ravel(), np.abs(count).ravel())
        t = np.full(len(x), self.t_us, np.int64)
        start, self.t_us = self.t_us, self.t_us + FRAME_US
        return EventPacket(
            x.astype(np.uint16), y.astype(np.uint16), on, t, start, self.t_us, (84, 84)
        )


def measured(course, calibration=CALIBRATION, halves=False, flip=False):
    """Return the last growth of a course of shifts (px) and growths."""
    skin, gauge, told = Skin(), DiscGrowthGauge(calibration), None
    for shift, growth in course:
        packet = skin.go(PLACES + shift, growth)
        if flip:
            packet = dataclasses.replace(packet, p=~packet.p)
        middle = len(packet) // 2 if halves else 0
        parts = [packet.part(0, middle, packet.t_start_us, packet.t_start_us)]
        parts.append(packet.part(middle, len(packet), packet.t_start_us, packet.t_end_us))
        for part in parts:
            gauge.absorb(part)
        told = gauge.measure(packet.t_end_us, PLACES + shift, resting=shift == 0.0 and not growth)
    return told


STEADY = [(0.0, 0.0)] * 5
SHIFTED = [*STEADY, *((0.5 * k, 0.0) for k in range(1, 13))]


def test_a_shift_is_no_growth():
    told = measured(SHIFTED)
    assert np.abs(told.growth).max() < 0.006
    assert (np.abs(told.growth) < 2.0 * told.sigma).all()


@pytest.mark.parametrize("growth", [-0.06, 0.04, 0.1, 0.2])
def test_growth_is_told_at_rest_and_under_a_shift(growth: float):
    # 4 px in steps of 0.25: the rim sweeps its pixels, as under any real touch.
    for shift in (0.0, 0.25):
        course = [*STEADY, *((k * shift, growth * k / 16) for k in range(1, 17))]
        told = measured(course)
        np.testing.assert_allclose(told.growth, growth, atol=0.012)
        assert (np.abs(told.growth - growth) < 2.0 * told.sigma).all()


def test_neither_the_cutting_of_the_stream_nor_the_polarity_matters():
    course = [*STEADY, *((0.3 * k, 0.01 * k) for k in range(1, 9))]
    whole, cut = measured(course), measured(course, halves=True)
    np.testing.assert_array_equal(whole.growth, cut.growth)
    dark = dataclasses.replace(CALIBRATION, polarity="dark")
    np.testing.assert_allclose(measured(course, dark, flip=True).growth, whole.growth, atol=1e-6)


def test_what_noise_adds_at_rest_is_taken_off_in_a_touch():
    rng = np.random.default_rng(0)
    rings = np.abs(np.hypot(*(np.mgrid[:84, :84] - PLACES[0][::-1, None, None])) - 7.5) < 2.0
    y, x = np.nonzero(rings)
    gauge, growth = DiscGrowthGauge(CALIBRATION), []
    for frame in range(150):
        chosen = rng.random(len(x)) < 0.01
        count = int(chosen.sum())
        start = frame * FRAME_US
        gauge.absorb(
            EventPacket(
                x[chosen].astype(np.uint16), y[chosen].astype(np.uint16),
                np.ones(count, np.bool_), np.full(count, start, np.int64),
                start, start + FRAME_US, (84, 84),
            )
        )  # fmt: skip
        told = gauge.measure(start + FRAME_US, PLACES, resting=frame < 100)
        growth.append(told)
    plain = DiscGrowthConfig(drift_share=1e-9)
    assert growth[-1].sigma[0] > 2.0 * DiscGrowthGauge(CALIBRATION, plain).measure(
        0, PLACES, resting=True
    ).sigma[0]
    # One disc of four is noisy, and the rate is that of all: what is left is within its error.
    assert (np.abs(growth[-1].growth) < 4.0 * growth[-1].sigma).all()


def test_reset_forgets_everything():
    skin, gauge = Skin(), DiscGrowthGauge(CALIBRATION)
    gauge.absorb(skin.go(PLACES, 0.1))
    assert gauge.measure(FRAME_US, PLACES, resting=False).growth.min() > 0.05
    gauge.reset()
    assert np.abs(gauge.measure(0, PLACES, resting=False).growth).max() < 1e-9


def test_calibrations_without_a_swing_are_refused_with_a_reason():
    assert why_no_growth(CALIBRATION) is None
    by_hand = dataclasses.replace(CALIBRATION, contrast=None, step_on=None)
    assert "contrast, step_on" in (why_no_growth(by_hand) or "")
    dull = dataclasses.replace(CALIBRATION, step_off=0.8)
    assert "80 % of the full swing" in (why_no_growth(dull) or "")
    for unfit in (by_hand, dull):
        with pytest.raises(ConfigError, match="growth of the discs cannot be told"):
            DiscGrowthGauge(unfit)


def test_settings_are_positive():
    with pytest.raises(ValueError, match="zero_s"):
        DiscGrowthConfig(zero_s=0.0)
