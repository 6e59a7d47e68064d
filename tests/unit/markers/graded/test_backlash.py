"""A gear with play, turned to and fro: what is made good, and what is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.backlash import MOST_PLAY_PX, BacklashCompensation, play_px
from spikingtac.markers.graded.tracker import MaintenanceConfig
from stand_ins.moving_rims import calibration


def driven(marker_px: np.ndarray, play: float) -> np.ndarray:
    """Return where a part goes that follows along x with play: the textbook's operator."""
    part, given = marker_px[0], []
    for place in marker_px:
        part = min(max(part, place - play), place + play)
        given.append(part)
    return np.array(given)


def made_good(fitted_px: np.ndarray, play: float) -> np.ndarray:
    backlash = BacklashCompensation(np.array([play]), np.array([[fitted_px[0], 7.0]]))
    given = []
    for x in fitted_px:
        place = backlash.update(np.array([[x, 7.0]]), np.zeros((1, 2)), 0.0)
        assert place[0, 1] == 7.0
        given.append(place[0, 0])
    return np.array(given)


def test_a_marker_that_turns_round_is_given_where_it_is() -> None:
    t = np.linspace(0.0, 6.0, 3001)
    marker = 20.0 + 2.0 * np.sin(2.0 * np.pi * t)
    fitted = driven(marker, 0.1)
    error_before, error_after = np.abs(fitted - marker), np.abs(made_good(fitted, 0.1) - marker)
    assert error_before.mean() > 0.08
    assert error_after.mean() < 0.25 * error_before.mean()  # the rest is the way through the play
    assert np.median(error_after) < 1e-12


def test_it_is_never_ahead_by_more_than_the_play() -> None:
    fitted = np.cumsum(np.random.default_rng(1).normal(0.0, 0.3, 500))
    assert np.abs(made_good(fitted, 0.12) - fitted).max() <= 0.12 + 1e-12


def test_the_lag_is_made_good_too_and_nothing_else_while_events_are_lost() -> None:
    backlash = BacklashCompensation(np.array([0.1]), np.zeros((1, 2)))
    fitted, velocity = np.array([[1.0, 0.0]]), np.array([[40.0, -10.0]])
    whole = backlash.update(fitted, velocity, 2e-3)
    np.testing.assert_allclose(whole, [[1.18, -0.02]])
    lossy = backlash.update(fitted, velocity, 2e-3, whole=False)
    np.testing.assert_allclose(lossy, [[1.08, -0.02]])


def test_without_play_the_fit_is_given() -> None:
    fitted = np.linspace(0.0, 5.0, 50)
    np.testing.assert_array_equal(made_good(fitted, 0.0), fitted)


def test_a_marker_that_was_found_elsewhere_tells_nothing_of_its_way() -> None:
    assert made_good(np.array([0.0, 12.0]), 0.1)[-1] == 12.0


def test_the_play_grows_with_step_and_width_and_is_bounded() -> None:
    sensor = replace(calibration(), step_on=0.1, step_off=0.1)
    small = play_px(appearance_of(sensor), 0.2)
    assert (small > 0.0).all()
    assert (small < MOST_PLAY_PX).all()
    larger = play_px(appearance_of(replace(sensor, step_on=0.15, step_off=0.15)), 0.2)
    np.testing.assert_allclose(larger, 1.5 * small)
    narrow, wide = (
        play_px(appearance_of(replace(sensor, edge_px=edge_px)), 0.2) for edge_px in (0.6, 0.9)
    )
    np.testing.assert_allclose(wide, 1.5 * narrow, rtol=0.02)
    assert (play_px(appearance_of(sensor), 50.0) == MOST_PLAY_PX).all()


def test_a_negative_share_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"backlash is -0\.1, it must not be negative"):
        MaintenanceConfig(backlash=-0.1)
