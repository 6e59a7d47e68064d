"""What a contact leaves behind is taken off, and a static press is not."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.markers.released_zero import ReleasedZero

REST_PX = np.array([[10.0, 10.0], [40.0, 10.0], [70.0, 10.0]])
LEFT_PX = np.array([[0.6, 0.0], [-0.3, 0.4], [0.0, -0.5]])
SEEN = np.zeros(3, bool)
DT_S = 0.01


def shown_px(
    zero: ReleasedZero, left_px: np.ndarray, seconds: float, speed_px_s: float = 0.0
) -> np.ndarray:
    """Hold the skin somewhere, moving or still; return the displacement that is given out."""
    velocity_px_s, given_px = np.full((3, 2), speed_px_s), REST_PX
    for _ in range(round(seconds / DT_S)):
        given_px = zero.update(REST_PX + left_px, velocity_px_s, SEEN, DT_S)
    return given_px - REST_PX


def pressed(zero: ReleasedZero) -> None:
    shown_px(zero, np.full((3, 2), 4.0), 0.2, speed_px_s=50.0)


def test_what_is_left_after_a_contact_is_taken_off() -> None:
    zero = ReleasedZero(REST_PX, Neighbourhood(REST_PX))
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, LEFT_PX, 1.0), 0.0, atol=1e-3)


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_soft_press_from_rest_stays(seconds: float) -> None:
    np.testing.assert_allclose(
        shown_px(ReleasedZero(REST_PX, Neighbourhood(REST_PX)), LEFT_PX, seconds),
        LEFT_PX,
        atol=1e-9,
    )


@pytest.mark.parametrize("left_px", [np.full((3, 2), 0.7), 6.0 * LEFT_PX, 2.0 * np.eye(3, 2)])
def test_a_press_that_is_held_is_no_rest(left_px: np.ndarray) -> None:
    zero = ReleasedZero(REST_PX, Neighbourhood(REST_PX))
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, left_px, 60.0), left_px, atol=1e-9)


def test_what_differs_from_marker_to_marker_is_no_press_where_the_same_size_alike_is() -> None:
    for left_px, rests in ((2.5 * LEFT_PX, True), (np.full((3, 2), 1.0), False)):
        zero = ReleasedZero(REST_PX, Neighbourhood(REST_PX))
        pressed(zero)
        assert np.linalg.norm(left_px, axis=1).mean() > 1.3
        np.testing.assert_allclose(
            shown_px(zero, left_px, 1.5), 0.0 if rests else left_px, atol=1e-3
        )


def test_nothing_is_learned_while_the_skin_moves() -> None:
    zero = ReleasedZero(REST_PX, Neighbourhood(REST_PX))
    pressed(zero)
    np.testing.assert_allclose(shown_px(zero, LEFT_PX, 1.0, speed_px_s=20.0), LEFT_PX, atol=1e-9)


def test_markers_that_are_held_tell_nothing() -> None:
    zero, held = ReleasedZero(REST_PX, Neighbourhood(REST_PX)), np.array([False, False, True])
    pressed(zero)
    given_px = REST_PX
    for _ in range(100):
        given_px = zero.update(REST_PX + LEFT_PX, np.zeros((3, 2)), held, DT_S)
    np.testing.assert_allclose(given_px[:2], REST_PX[:2], atol=1e-3)
    np.testing.assert_allclose(given_px[2], REST_PX[2] + LEFT_PX[2], atol=1e-9)
    unseen = zero.update(REST_PX + LEFT_PX, np.zeros((3, 2)), np.ones(3, bool), DT_S)
    np.testing.assert_allclose(unseen, REST_PX + LEFT_PX, atol=1e-9)
