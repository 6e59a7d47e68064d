"""A gear with play, turned to and fro: what is made good, and what is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.markers.graded.backlash import (
    MOST_CROSSING_PX,
    RENEWED_HZ_PX,
    SHORT_PLAY,
    BacklashCompensation,
    crossing_px,
)
from spikingtac.markers.maintenance_config import MaintenanceConfig
from stand_ins.moving_rims import calibration

CROSSING_PX = 0.4
STILL = np.zeros((1, 2))


def driven(marker_px: np.ndarray, play: float) -> np.ndarray:
    """Return where a part goes that follows along x with play: the textbook's operator."""
    part, given = marker_px[0], []
    for place in marker_px:
        part = min(max(part, place - play), place + play)
        given.append(part)
    return np.array(given)


def compensation(start_px: np.ndarray, steady: float, turning: float) -> BacklashCompensation:
    """Return one in which each marker tells its direction by itself."""
    alone = np.arange(len(start_px))[:, np.newaxis]
    crossings = np.full(len(start_px), CROSSING_PX)
    return BacklashCompensation(crossings, (steady, turning), start_px, alone)


def made_good(fitted_px: np.ndarray, steady: float, turning: float = 0.0) -> np.ndarray:
    backlash = compensation(np.array([[fitted_px[0], 7.0]]), steady, turning)
    given = []
    for x in fitted_px:
        place = backlash.update(np.array([[x, 7.0]]), np.zeros((1, 2)), 0.0)
        assert place[0, 1] == 7.0
        given.append(place[0, 0])
    return np.array(given)


def test_a_marker_that_turns_round_is_given_where_it_is() -> None:
    t = np.linspace(0.0, 6.0, 3001)
    marker, play = 20.0 + 2.0 * np.sin(2.0 * np.pi * t), SHORT_PLAY * CROSSING_PX
    fitted = driven(marker, play)
    error_before = np.abs(fitted - marker)
    error_after = np.abs(made_good(fitted, SHORT_PLAY) - marker)
    assert error_before.mean() > 0.8 * play
    assert error_after.mean() < 0.25 * error_before.mean()  # the rest is the way through the play
    assert np.median(error_after) < 1e-12


def test_after_a_turn_it_is_farther_ahead_and_the_fit_catches_up() -> None:
    fitted = np.concatenate([np.linspace(0.0, 10.0, 1001), np.linspace(10.0, 0.0, 1001)])
    ahead = made_good(fitted, 0.1, 0.3) - fitted
    np.testing.assert_allclose(ahead[1000], 0.1 * CROSSING_PX)
    turned = 1001 + round(2.0 * SHORT_PLAY * CROSSING_PX / 0.01)
    assert ahead[turned] < -0.55 * CROSSING_PX
    np.testing.assert_allclose(ahead[-1], -0.1 * CROSSING_PX)
    assert (np.diff(ahead[turned + 1 :]) > -1e-12).all()


def test_neighbours_tell_a_turn_that_the_own_fit_does_not_show_yet() -> None:
    start_px = np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0]])
    crossings, neighbours = np.full(3, CROSSING_PX), np.array([[1, 2], [0, 2], [0, 1]])
    backlash = BacklashCompensation(crossings, (0.15, 0.3), start_px, neighbours)
    together = backlash.update(start_px + np.array([1.0, 0.0]), np.zeros((3, 2)), 0.0)
    waiting_px = together.copy()
    for moved_px in ([1.0, 0.9, 0.9], [1.0, 0.8, 0.8]):
        fitted_px = start_px + np.column_stack([moved_px, np.zeros(3)])
        waiting_px = backlash.update(fitted_px, np.zeros((3, 2)), 0.0)
    assert waiting_px[0, 0] < together[0, 0] - 0.4 * CROSSING_PX


def test_neighbours_that_went_another_way_do_not_count() -> None:
    start_px = np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0]])
    crossings, neighbours = np.full(3, CROSSING_PX), np.array([[1, 2], [0, 2], [0, 1]])
    backlash = BacklashCompensation(crossings, (0.15, 0.0), start_px, neighbours)
    fitted_px = start_px + np.array([[0.0, 0.0], [1.9, 0.0], [-1.9, 0.0]])
    given_px = backlash.update(fitted_px, np.zeros((3, 2)), 0.0)
    ahead_px = 0.15 * CROSSING_PX
    np.testing.assert_allclose(given_px - fitted_px, [[0, 0], [ahead_px, 0], [-ahead_px, 0]])


def test_it_is_never_ahead_by_more_than_its_shares() -> None:
    fitted = np.cumsum(np.random.default_rng(1).normal(0.0, 0.3, 500))
    ahead = np.abs(made_good(fitted, 0.15, 0.3) - fitted)
    assert 0.5 * CROSSING_PX < ahead.max() <= (0.15 + 2.0 * 0.3) * CROSSING_PX + 1e-12


def test_the_lag_is_made_good_too_and_nothing_else_until_a_step_is_known() -> None:
    backlash = compensation(np.zeros((1, 2)), 0.25, 0.0)
    fitted, velocity = np.array([[1.0, 0.0]]), np.array([[40.0, -10.0]])
    known = backlash.update(fitted, velocity, 2e-3)
    np.testing.assert_allclose(known, [[1.18, -0.02]])
    unknown = backlash.update(fitted, velocity, 2e-3, known=False)
    np.testing.assert_allclose(unknown, [[1.08, -0.02]])


def test_noise_lets_pixels_forget_a_turn() -> None:
    ahead = []
    for background_hz_px in (0.0, RENEWED_HZ_PX, 100.0):
        backlash = compensation(np.zeros((1, 2)), 0.0, 0.3)
        places = [
            backlash.update(np.array([[x, 0.0]]), STILL, 0.0, background_hz_px=background_hz_px)
            for x in (0.04, 0.08)
        ]
        ahead.append(places[-1][0, 0] - 0.08)
    np.testing.assert_allclose(ahead[1], 0.5 * ahead[0])
    assert ahead[0] > 0.05
    assert ahead[2] < 1e-4


def test_without_shares_the_fit_is_given() -> None:
    fitted = np.linspace(0.0, 5.0, 50)
    np.testing.assert_array_equal(made_good(fitted, 0.0), fitted)


def test_a_marker_that_was_found_elsewhere_tells_nothing_of_its_way() -> None:
    assert made_good(np.array([0.0, 12.0]), 0.25)[-1] == 12.0


def test_a_crossing_grows_with_step_and_width_and_is_bounded() -> None:
    sensor = replace(calibration(), step_on=0.05, step_off=0.05)
    small = crossing_px(sensor)
    assert (small > 0.0).all()
    assert (small < MOST_CROSSING_PX).all()
    larger = crossing_px(replace(sensor, step_on=0.075, step_off=0.075))
    np.testing.assert_allclose(larger, 1.5 * small)
    narrow, wide = (crossing_px(replace(sensor, edge_px=edge_px)) for edge_px in (0.6, 0.9))
    np.testing.assert_allclose(wide, 1.5 * narrow, rtol=0.02)
    pale = replace(sensor, step_on=0.9, step_off=0.9, edge_px=2.0)
    assert (crossing_px(pale) == MOST_CROSSING_PX).all()


def test_steps_that_were_scaled_apart_tell_no_crossing() -> None:
    alike = replace(calibration(), provenance={"step_scale": [0.8, 0.8]})
    np.testing.assert_array_equal(crossing_px(alike), crossing_px(calibration()))
    apart = replace(calibration(), provenance={"step_scale": [3.8, 0.64]})
    assert not crossing_px(apart).any()


@pytest.mark.parametrize("name", ["backlash", "turn_backlash"])
def test_a_negative_share_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} is -0\.1, it must not be negative"):
        MaintenanceConfig(**{name: -0.1})
