"""Streams of frames that are not as they should be: gaps, jumps in time, a touched start, a row."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from spikingtac.touch.detector import SCATTER_PX, TouchDetector
from spikingtac.touch.field import GradientOperator, straightened
from spikingtac.touch.patch import SquareLattice
from spikingtac.touch.slip.held import HeldTouchDetector
from spikingtac.touch.touch import RETURN_FACTOR, STILL_US, CalibratedRest
from spikingtac.types import MarkerFrame
from stand_ins.pressed_skin import CENTER, PITCH_PX, PRESS, REFERENCE, press, pulse, touches, watch

MM_PER_PX = 0.065
ROW = np.column_stack([PITCH_PX * np.arange(10.0), np.full(10, 80.0)])
PLACES_ONLY = "mm"  # Sensors that see places and not changes.


def one_press(t_s: float) -> float:
    return 4 * pulse(t_s, 0.8, 1.9)


@pytest.mark.parametrize(
    ("missing", "every"),
    [([27], 0), ([27], 1), ([27], 2), ([18, 19, 20, 26, 27, 28, 34, 35, 36], 1), ([0, 63], 3)],
)
def test_markers_without_a_place_do_not_hide_a_press(missing: list[int], every: int) -> None:
    def torn(frame: MarkerFrame, number: int) -> MarkerFrame:
        place = frame.detected_px.copy()
        if number % every == 0 if every else number == 100:
            place[missing, 0] = np.nan
            place[missing[0], 1] = np.inf
        return dataclasses.replace(frame, detected_px=place)

    detector = TouchDetector(REFERENCE, PLACES_ONLY)
    (touch,) = touches(detector, (torn(frame, k) for k, frame in enumerate(watch(one_press, 3.0))))
    assert touch.begin_us == pytest.approx(800_000, abs=12_000)
    assert touch.end_us == pytest.approx(1_900_000, abs=100_000)
    np.testing.assert_allclose(touch.place_px, CENTER, atol=0.5 * PITCH_PX)
    assert np.isfinite(detector.displacement_px).all()
    assert np.isfinite(detector.tracked_px).all()


def test_a_held_touch_ends_where_time_goes_back_and_the_next_has_its_own_slips() -> None:
    detector = HeldTouchDetector(REFERENCE, PLACES_ONLY)
    frames = [frame for frame in watch(one_press, 3.0) if frame.t_us < 1_200_000]
    held = [one for frame in 2 * frames if (one := detector.update(frame))]
    assert [one.touch.end_us for one in held] == [None]
    last = detector.finish()
    assert last is not None
    assert last.slips == held[0].slips
    assert last.touch.begin_us == held[0].touch.begin_us == pytest.approx(800_000, abs=10_000)


def held_at_first(
    strength: float, released_s: float, fall_s: float = 0.2
) -> Callable[[float], float]:
    """A skin that is strained from the first frame on, and then released."""
    depth = strength / GradientOperator(REFERENCE).strength_of(PRESS)
    return lambda t_s: depth * min(max((released_s - t_s) / fall_s, 0.0), 1.0) ** 2


@pytest.mark.parametrize("strength", [0.01, 0.03, 0.045])
@pytest.mark.parametrize("seconds", [4.0, 1.3])
def test_the_release_of_what_was_held_at_first_is_no_touch(strength: float, seconds: float) -> None:
    detector = TouchDetector(REFERENCE, PLACES_ONLY)
    assert touches(detector, watch(held_at_first(strength, 1.0), seconds)) == []


@pytest.mark.parametrize(("rise_s", "begin_us"), [(0.05, 50_000), (0.2, 100_000), (0.3, 110_000)])
def test_a_press_that_begins_with_the_recording_is_one_touch(
    rise_s: float, begin_us: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spikingtac.touch.detector.SCATTER_SHARE", SCATTER_PX / PITCH_PX)
    detector = TouchDetector(REFERENCE, PLACES_ONLY)
    (touch,) = touches(detector, watch(lambda t_s: 4 * pulse(t_s, 0.0, 1.5, rise_s), 4.0))
    assert touch.begin_us <= begin_us
    assert touch.end_us == pytest.approx(1_500_000, abs=1e6 * 0.5 * rise_s + 40_000)


def test_a_press_on_a_skin_that_is_held_ends_where_all_is_released_at_once() -> None:
    """By its peak alone it never does: what was held is no small share of that."""
    held = held_at_first(0.03, 2.0, fall_s=0.02)
    detector = TouchDetector(REFERENCE, PLACES_ONLY)
    frames = watch(lambda t_s: held(t_s) + 0.6 * 4 * pulse(t_s, 1.0, 2.0, 0.02), 4.0)
    (touch,) = touches(detector, frames)
    assert touch.begin_us == pytest.approx(1_000_000, abs=10_000)
    assert touch.end_us == pytest.approx(2_000_000, abs=20_000)


@pytest.mark.parametrize(("depth", "was_return"), [(-1.0, True), (0.5, False)])
def test_only_what_begins_towards_the_calibrated_rest_is_the_way_there(
    depth: float, was_return: bool
) -> None:
    gradient = GradientOperator(REFERENCE)
    off = gradient.strength_of(PRESS)
    home = CalibratedRest(gradient, PRESS, 0.1 * depth * PRESS)
    assert not home.was_return(off), "it is not back"
    assert home.update(0, 0.5 * PRESS) is None
    back_us = [home.update(t_us, 0.0 * PRESS) for t_us in (1_000, 2_000, 1_000 + STILL_US)]
    assert back_us == [None, None, 1_000]
    assert home.was_return(off) == was_return
    assert not home.was_return(RETURN_FACTOR * off), "something pressed meanwhile"


def test_markers_in_mm_are_felt_with_the_settings_for_mm() -> None:
    """With those for px the press of 4 px is 0.26 mm, and lost among what px may scatter."""
    reference = MM_PER_PX * REFERENCE
    for unit, found in (("px", 0), ("mm", 1)):
        frames = watch(one_press, 3.0)
        small = (dataclasses.replace(f, detected_px=MM_PER_PX * f.detected_px) for f in frames)
        told = touches(TouchDetector(reference, unit), small)
        assert len(told) == found
    assert told[0].begin_us == pytest.approx(800_000, abs=30_000)
    assert told[0].peak_displacement_px == pytest.approx(
        MM_PER_PX * 4.0 * np.hypot(*PRESS.T).max(), rel=0.05
    )


@pytest.mark.parametrize(("degrees", "bend_px"), [(0.0, 0.0), (33.0, 1e-9), (90.0, 1.0)])
def test_a_single_row_of_markers_feels_a_press(degrees: float, bend_px: float) -> None:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    bent = ROW + np.array([0.0, bend_px]) * ((np.arange(10.0) - 4.5) ** 2 / 20.0)[:, None]
    reference = bent @ turn
    center = ROW[4:6].mean(axis=0) @ turn
    frames = watch(one_press, 3.0, reference, press(1.0, reference, center))
    (touch,) = touches(TouchDetector(reference, PLACES_ONLY), frames)
    assert touch.begin_us == pytest.approx(800_000, abs=12_000)
    assert touch.end_us == pytest.approx(1_900_000, abs=100_000)
    assert touch.area_px2 > 0.0
    assert len(touch.outline_px) >= 4
    assert np.hypot(*(touch.place_px - center)) < 2.5 * PITCH_PX  # nothing was learned of rows
    assert SquareLattice(reference).weights is None


def test_a_row_is_straightened_and_two_rows_are_none() -> None:
    row = ROW + np.array([0.0, 1.0]) * (np.arange(10.0) % 2)[:, None]
    straight = straightened(row)
    assert straight is not None
    np.testing.assert_allclose(straight, row, atol=0.7)
    assert np.linalg.matrix_rank(straight - straight.mean(axis=0), tol=1e-9) == 1
    assert straightened(np.concatenate([ROW, ROW + np.array([0.0, PITCH_PX])])) is None
    assert straightened(REFERENCE) is None
