"""Places and lengths on the skin, with one scale and with a lens."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.lens import Lens, SkinScale

CENTER_PX = (160.0, 120.0)
HALF_DIAGONAL_PX = 200.0
PX_PER_MM = 10.0


def lens(radial: float) -> Lens:
    """A lens whose scale at the image's centre is PX_PER_MM, with its origin elsewhere."""
    reach_mm = HALF_DIAGONAL_PX / PX_PER_MM
    homography = np.array([[reach_mm, 0.0, 3.0], [0.0, reach_mm, -2.0], [0.0, 0.0, 1.0]])
    return Lens(
        center_px=CENTER_PX,
        half_diagonal_px=HALF_DIAGONAL_PX,
        radial=radial,
        radial_sigma=0.001,
        homography=homography,
        residual_mm=0.001,
    )


def test_one_scale_divides() -> None:
    scale = SkinScale(PX_PER_MM)
    np.testing.assert_allclose(scale.to_mm(np.array([[20.0, 5.0]])), [[2.0, 0.5]])
    assert scale.mm_per_px(np.array([20.0, 5.0])) == pytest.approx(0.1)


def test_a_lens_without_distortion_is_that_scale() -> None:
    places = np.array([[0.0, 0.0], [160.0, 120.0], [310.0, 7.0]])
    scale = SkinScale(PX_PER_MM, lens(0.0))
    np.testing.assert_allclose(scale.to_mm(places), places / PX_PER_MM, atol=1e-12)
    assert scale.mm_per_px(places[2]) == pytest.approx(0.1)


def test_the_local_scale_is_that_of_small_areas() -> None:
    scale, place = SkinScale(PX_PER_MM, lens(-0.2)), np.array([300.0, 30.0])
    corners = place + np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])
    x, y = scale.to_mm(corners).T
    area_mm2 = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert scale.mm_per_px(place) == pytest.approx(np.sqrt(area_mm2 / 16.0), rel=1e-3)
    assert scale.mm_per_px(np.array(CENTER_PX)) == pytest.approx(0.1, rel=1e-4)
