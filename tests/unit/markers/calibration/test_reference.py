"""Creep after presses is told from the reference; symmetrical slides still cancel."""

import numpy as np

from spikingtac.markers.calibration.reference import displaced_before, reference

PLACES = np.array([[x, y] for y in (20.0, 60.0, 100.0) for x in (20.0, 60.0, 100.0)])


def rests(lengths_s: list[float]) -> np.ndarray:
    return 1e6 * (np.outer(lengths_s, [0, 1]) + 10.0 * np.arange(len(lengths_s))[:, np.newaxis])


def outward(*shares: float) -> np.ndarray:
    return np.multiply.outer(shares, (PLACES - PLACES.mean(axis=0)) * 0.2)


def test_what_presses_leave_spread_is_not_the_reference() -> None:
    displaced, lengths_s = outward(0, *[1] * 6), [0.5, *[0.3] * 6]
    spread = PLACES + 0.1 * displaced
    found = reference(spread, rests(lengths_s), displaced, "rest-mean")
    np.testing.assert_allclose(found, PLACES, atol=1e-9)
    # Without a rest before the first press nothing tells creep from the place.
    late = reference(spread[1:], rests(lengths_s[1:]), displaced[1:], "rest-mean")
    np.testing.assert_allclose(late, PLACES + outward(0.1)[0])


def test_contacts_of_several_sizes_tell_creep_without_a_rest_before_them() -> None:
    displaced = outward(1.0, 2.0, 0.5)
    found = reference(PLACES + 0.1 * displaced, rests([0.3] * 3), displaced, "rest-mean")
    np.testing.assert_allclose(found, PLACES, atol=1e-9)


def test_a_skin_that_slides_leave_spread_is_told_by_the_rest_before_them() -> None:
    ways_px = np.array([[0.0, 0.0], [6.0, 0.0], [-6.0, 0.0], [0.0, 6.0], [0.0, -6.0]])
    displaced = ways_px[:, np.newaxis] + 0.0 * PLACES
    places = PLACES + outward(0, *[0.01] * 4) + 0.02 * displaced
    found = reference(places, rests([0.6, *[0.3] * 4]), displaced, "rest-mean")
    np.testing.assert_allclose(found, PLACES, atol=1e-9)


def test_a_first_rest_that_is_wrong_does_not_outvote_the_others() -> None:
    wrong = outward(0.1, *[0] * 6)  # no skin creeps this way
    found = reference(PLACES + wrong, rests([0.6] * 7), outward(0, *[1] * 6), "rest-mean")
    assert np.abs(found - PLACES).max() < 0.1 * np.abs(wrong).max()


def test_the_displacement_before_a_rest_is_the_mean_since_the_rest_before() -> None:
    course_px = np.add.outer(np.repeat([0.0, 3.0, 0.0, 5.0, 5.0], 10), PLACES)
    spans_us, rest_px = 100 * np.arange(6).reshape(3, 2), np.array([PLACES] * 3)
    found = displaced_before(spans_us, rest_px, np.arange(0, 500, 10), course_px)
    np.testing.assert_allclose(found, np.add.outer([0.0, 3.0, 5.0], 0.0 * PLACES))


def test_the_bounding_box_is_the_papers() -> None:
    places = np.add.outer([0.0, 1.0, 0.2], PLACES)
    found = reference(places, rests([1.0] * 3), 0.0 * places, "bounding-box")
    np.testing.assert_allclose(found, PLACES + 0.5)
