"""Creep after presses is told from the reference; symmetrical slides still cancel."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.calibration.reference import reference

PLACES = np.array([[x, y] for y in (20.0, 60.0, 100.0) for x in (20.0, 60.0, 100.0)])
SECOND_US = 1_000_000


def rests(lengths_s: list[float], first_us: int = 0) -> np.ndarray:
    begins = first_us + np.arange(len(lengths_s)) * 10 * SECOND_US
    return np.column_stack([begins, begins + np.array(lengths_s) * SECOND_US]).astype(np.int64)


def test_what_presses_leave_spread_is_not_the_reference() -> None:
    outward = (PLACES - PLACES.mean(axis=0)) * 0.02
    spread = np.array([PLACES, *[PLACES + outward] * 6])
    found = reference(spread, rests([0.5, *[0.3] * 6]), "rest-mean")
    assert np.abs(found - PLACES).max() < 0.1 * np.abs(outward).max()
    # Without a rest before the first press nothing tells creep from the place.
    late = reference(spread[1:], rests([0.3] * 6, first_us=SECOND_US), "rest-mean")
    np.testing.assert_allclose(late, PLACES + outward)


def test_slides_to_and_fro_cancel_and_outweigh_one_bad_first_rest() -> None:
    rng = np.random.default_rng(1)
    ways = np.array([[0.2, 0.0], [-0.2, 0.0], [0.0, 0.2], [0.0, -0.2]] * 3)[:, np.newaxis]
    first = PLACES + rng.normal(0.0, 0.1, PLACES.shape)
    found = reference(np.array([first, *(PLACES + ways)]), rests([0.5] + [0.3] * 12), "rest-mean")
    assert np.abs(found - PLACES).mean() < 0.5 * np.abs(first - PLACES).mean()


def test_a_long_rest_counts_as_much_as_the_first() -> None:
    apart = np.array([PLACES, PLACES + 0.1, PLACES + 1.0])
    found = reference(apart, rests([3.0, 4.0, 0.3]), "rest-mean")
    assert np.abs(found - (PLACES + 0.05)).max() < 0.05


def test_the_bounding_box_is_the_papers() -> None:
    apart = np.array([PLACES, PLACES + 1.0, PLACES + 0.2])
    found = reference(apart, rests([1.0, 1.0, 1.0]), "bounding-box")
    np.testing.assert_allclose(found, PLACES + 0.5)


@pytest.mark.parametrize("count", [1, 2])
def test_few_rests_are_enough(count: int) -> None:
    found = reference(np.array([PLACES] * count), rests([0.3] * count), "rest-mean")
    np.testing.assert_allclose(found, PLACES)
