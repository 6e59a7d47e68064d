"""The picture of a hole: to equal scale, magnified as its legend says, truth only where known."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from spikingtac.geometry.hole import Circle
from spikingtac.plots.circles import PLANE_REGION, HolePicture, draw_hole
from spikingtac.plots.figure import THEMES

RADIUS_MM = 2.0
RESIDUAL_MM = np.array([0.02, -0.01, 0.0, 0.015])
ANGLE_RAD = np.radians([10.0, 100.0, 190.0, 280.0])


def picture(sigma_mm: float = 0.02, off_mm: float = 0.03) -> HolePicture:
    circle = Circle(
        np.array([off_mm, 0.0]),
        RADIUS_MM,
        np.diag([sigma_mm, 2.0 * sigma_mm, sigma_mm]) ** 2,
        RESIDUAL_MM,
    )
    reading = circle.center_mm + 1.7 * np.column_stack([np.cos(ANGLE_RAD), np.sin(ANGLE_RAD)])
    return HolePicture(
        circle=circle,
        reading_mm=reading,
        true_center_mm=np.zeros(2),
        true_radius_mm=RADIUS_MM,
    )


def test_what_is_drawn_is_what_the_legend_says() -> None:
    axes = Figure().add_subplot()
    one = picture()
    draw_hole(axes, one, THEMES["light"])
    handles, labels = axes.get_legend_handles_labels()
    drawn = dict(zip(labels, handles, strict=True))
    assert axes.get_aspect() == 1.0
    region = drawn[f"95 % region of the centre × {one.center_factor:g}"]
    assert isinstance(region, Ellipse)
    assert max(region.width, region.height) == pytest.approx(
        2.0 * one.center_factor * 0.04 * np.sqrt(PLANE_REGION)
    )
    away = drawn[f"true centre, its distance × {one.center_factor:g}"].get_xydata()[0]
    np.testing.assert_allclose(away, [0.03 * (1.0 - one.center_factor), 0.0], atol=1e-12)
    contacts = drawn[f"contacts, residual × {one.residual_factor:g}"].get_xydata()
    distance = np.linalg.norm(contacts - one.circle.center_mm, axis=1)
    np.testing.assert_allclose(distance, RADIUS_MM + one.residual_factor * RESIDUAL_MM)
