"""Growth of the discs from events that were made by hand: no camera, no calibration run."""

import dataclasses

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.touch.indentation.disc_growth import (
    DiscGrowth,
    DiscGrowthConfig,
    DiscGrowthGauge,
)
from spikingtac.touch.indentation.resting_discs import why_no_growth
from spikingtac.types import EventPacket
from stand_ins.painted_skin import PaintedSkin, square_calibration

FRAME_US = 10_000
CALIBRATION = square_calibration(2)
PLACES = CALIBRATION.reference_px


def measured(course, calibration=CALIBRATION, halves=False, flip=False) -> DiscGrowth:
    """Return the last growth of a course of shifts (px) and growths."""
    skin, gauge = PaintedSkin(CALIBRATION, FRAME_US), DiscGrowthGauge(calibration)
    told = gauge.measure(0, PLACES, resting=True)
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
    # At rest a pixel keeps up to a step to itself, always on the same side; a rim that sweeps it
    # takes that along, as under any real touch.
    for shift, error in ((0.0, 0.02), (0.25, 0.006)):
        course = [*STEADY, *((k * shift, growth * k / 16) for k in range(1, 17))]
        told = measured(course)
        np.testing.assert_allclose(told.growth, growth, atol=error)


@pytest.mark.parametrize("pitch_px", [22.0, 20.0, 18.0])
@pytest.mark.parametrize("growth", [0.0, 0.1, 0.2])
def test_neighbours_do_not_wipe_each_other(pitch_px: float, growth: float):
    """Dense discs shrank by themselves when they shifted: by 0.15 at a pitch of 18 px."""
    known = square_calibration(3, pitch_px)
    skin, gauge = PaintedSkin(known, FRAME_US), DiscGrowthGauge(known)
    rest, told = known.reference_px, gauge.measure(0, known.reference_px, resting=True)
    for k in range(17):
        gauge.absorb(skin.go(rest + 0.25 * k, growth * k / 16))
        told = gauge.measure(skin.t_us, rest + 0.25 * k, resting=k == 0)
    np.testing.assert_allclose(told.growth, growth, atol=0.005 + 0.1 * growth)
    assert (np.abs(told.growth - growth) < 2.0 * told.sigma).all()


def test_discs_that_would_merge_are_refused():
    assert why_no_growth(square_calibration(3, 17.5)) is None
    why = why_no_growth(square_calibration(3, 16.0))
    assert why is not None
    assert "2.0 px apart" in why


def test_neither_the_cutting_of_the_stream_nor_the_polarity_matters():
    course = [*STEADY, *((0.3 * k, 0.01 * k) for k in range(1, 9))]
    whole, cut = measured(course), measured(course, halves=True)
    np.testing.assert_array_equal(whole.growth, cut.growth)
    dark = dataclasses.replace(CALIBRATION, polarity="dark")
    np.testing.assert_allclose(measured(course, dark, flip=True).growth, whole.growth, atol=1e-6)


def test_what_noise_adds_at_rest_is_taken_off_in_a_touch():
    rng = np.random.default_rng(0)
    gauge = DiscGrowthGauge(CALIBRATION)
    width, height = CALIBRATION.size
    quiet = gauge.measure(0, PLACES, resting=True)
    told = quiet
    for frame in range(150):
        count = 20  # ON events at random: 0.3 of each pixel in a second, as a noisy leak
        x, y = (rng.integers(0, side, count).astype(np.uint16) for side in (width, height))
        start = frame * FRAME_US
        t, on = np.full(count, start, np.int64), np.ones(count, np.bool_)
        gauge.absorb(EventPacket(x, y, on, t, start, start + FRAME_US, (width, height)))
        told = gauge.measure(start + FRAME_US, PLACES, resting=frame < 100)
    without = DiscGrowthGauge(CALIBRATION, DiscGrowthConfig(drift_share=1e-9))
    assert told.sigma[0] > 1.1 * without.measure(0, PLACES, resting=True).sigma[0]
    assert np.abs(told.growth.mean()) < 0.008
    assert (np.abs(told.growth) < 2.5 * told.sigma).all()


def test_a_touch_that_is_noticed_late_is_neither_zero_nor_drift():
    skin, gauge = PaintedSkin(CALIBRATION, FRAME_US), DiscGrowthGauge(CALIBRATION)
    told = gauge.measure(0, PLACES, resting=True)
    for frame in range(40):
        places, growth = PLACES + 0.25 * max(frame - 20, 0), 0.005 * max(frame - 20, 0)
        gauge.absorb(skin.go(places, growth))
        told = gauge.measure(skin.t_us, places, resting=frame < 26)  # 60 ms late
    np.testing.assert_allclose(told.growth, 0.005 * 19, atol=0.01)


def test_reset_forgets_everything():
    skin, gauge = PaintedSkin(CALIBRATION, FRAME_US), DiscGrowthGauge(CALIBRATION)
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
    recovering = dataclasses.replace(CALIBRATION, recovery_s=0.2)
    assert "pixels of this sensor forget" in (why_no_growth(recovering) or "")
    for unfit in (by_hand, dull, recovering):
        with pytest.raises(ConfigError, match="growth of the discs cannot be measured"):
            DiscGrowthGauge(unfit)


def test_settings_are_positive():
    with pytest.raises(ValueError, match="zero_s"):
        DiscGrowthConfig(zero_s=0.0)
