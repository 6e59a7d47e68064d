"""Rests become a reference: the paper's box, or a mean without what contacts leave behind."""

import numpy as np

from spikingtac.markers.calibration.reference import reference, touched_before

PLACES = np.array([[x, y] for y in (20.0, 60.0, 100.0) for x in (20.0, 60.0, 100.0)])
OUTWARD = PLACES - PLACES.mean(axis=0)
SECOND_US = 1_000_000


def rest_mean(places: np.ndarray, touched: np.ndarray | bool = True) -> np.ndarray:
    """Return the reference of rests of a second each, the first one without any contact before."""
    before = np.broadcast_to(touched, len(places))
    return reference(places, np.full(len(places), SECOND_US), before, "rest-mean")


def test_what_contacts_leave_spread_is_not_the_reference() -> None:
    spread = np.array([PLACES, *[PLACES + 0.02 * OUTWARD] * 6])
    np.testing.assert_allclose(rest_mean(spread, np.arange(7) > 0), PLACES, atol=1e-9)
    # Without a rest before the first contact nothing tells it from the place.
    np.testing.assert_allclose(rest_mean(spread[1:]), spread[1])


def test_a_skin_that_slides_leave_spread_is_told_by_the_rest_before_them() -> None:
    ways_px = 0.12 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])[:, np.newaxis]
    places = np.array([PLACES, *(PLACES + 0.002 * OUTWARD + ways_px)])
    np.testing.assert_allclose(rest_mean(places, np.arange(5) > 0), PLACES, atol=1e-6)


def test_a_first_rest_that_is_wrong_does_not_outvote_the_others() -> None:
    places = np.array([PLACES + 0.02 * OUTWARD, *[PLACES] * 6])  # no skin creeps this way
    assert np.abs(rest_mean(places, np.arange(7) > 0) - PLACES).max() < 0.08


def test_long_rests_count_more_up_to_what_skins_take_to_settle() -> None:
    places = np.array([PLACES, PLACES + 0.01])
    found = reference(places, SECOND_US * np.array([1, 30]), np.ones(2, bool), "rest-mean")
    np.testing.assert_allclose(found, PLACES + 0.0075, atol=1e-4)


def test_a_contact_is_a_motion_of_the_markers() -> None:
    moved_px = np.array([0.0, 0.1, 0.0, 4.0, 0.1, 0.0, 0.0])
    course_px = PLACES + moved_px[:, np.newaxis, np.newaxis]
    found = touched_before(course_px, np.array([0, 2, 5]))
    assert found.tolist() == [False, False, True]


def test_the_bounding_box_is_the_papers() -> None:
    apart = np.array([PLACES, PLACES + 1.0, PLACES + 0.2])
    found = reference(apart, np.full(3, SECOND_US), np.zeros(3, bool), "bounding-box")
    np.testing.assert_allclose(found, PLACES + 0.5)
