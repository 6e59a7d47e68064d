"""How much of each disc was seen, against counting pixels by hand."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.calibration.guide_levels import OPPOSITE, SIDES, coverage

SHAPE = (40, 60)


def counted(swung: np.ndarray, center: tuple[float, float], radius: float) -> float:
    inside = seen = 0
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            if np.hypot(x - center[0], y - center[1]) <= radius:
                inside += 1
                seen += swung[y, x]
    return seen / inside


def test_the_share_is_that_of_the_pixels() -> None:
    swung = np.random.default_rng(1).random(SHAPE) < 0.4
    centers = [(12.3, 9.8), (45.5, 30.0), (2.0, 38.6)]  # the last one is cut by two borders
    found = coverage(swung, np.array(centers), 6.4)
    expected = [counted(swung, center, 6.4) for center in centers]
    np.testing.assert_allclose(found.share, expected)


@pytest.mark.parametrize(("side", "way"), [((1, 0), 0), ((-1, 0), 1), ((0, 1), 2), ((0, -1), 3)])
def test_each_quarter_is_told(side: tuple[int, int], way: int) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    swung = (x - 30) * side[0] + (y - 20) * side[1] > 0
    found = coverage(swung, np.array([[30.0, 20.0]]), 8.0)
    assert int(found.sides[0].argmax()) == way
    assert found.sides[0, way] == 1.0
    assert found.sides[0, way ^ 1] == 0.0
    # A disc's right quarter is uncovered by going left, and seen when it comes back.
    assert {"right": "left", "left": "right", "lower": "up", "upper": "down"}[SIDES[way]] == (
        OPPOSITE[way]
    )


def test_a_disc_outside_of_the_image_was_not_seen() -> None:
    found = coverage(np.ones(SHAPE, bool), np.array([[-50.0, 10.0]]), 5.0)
    assert found.share.tolist() == [0.0]
    assert found.sides.tolist() == [[0.0] * 4]
