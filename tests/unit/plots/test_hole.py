"""The picture of a hole: to equal scale, magnified as its legend says, truth only where known."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from spikingtac.geometry.hole import Circle
from spikingtac.plots.hole import (
    CENTER_FRACTION,
    FACTORS,
    PLANE_REGION,
    RESIDUAL_FRACTION,
    HolePicture,
    draw_hole,
    save_hole_plot,
)

RADIUS_MM = 2.0
RESIDUAL_MM = np.array([0.02, -0.01, 0.0, 0.015])
ANGLE_RAD = np.radians([10.0, 100.0, 190.0, 280.0])


def picture(sigma_mm: float = 0.02, off_mm: float = 0.03, known: bool = True) -> HolePicture:
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
        true_center_mm=np.zeros(2) if known else None,
        true_radius_mm=RADIUS_MM if known else None,
    )


@pytest.mark.parametrize("sigma_mm", [1e-4, 0.003, 0.02, 0.1, 3.0])
def test_factors_are_the_largest_that_fit(sigma_mm: float) -> None:
    one = picture(sigma_mm)
    size = max(2.0 * sigma_mm * np.sqrt(PLANE_REGION), 0.03)
    larger = [factor for factor in FACTORS if factor > one.center_factor]
    assert one.center_factor * size <= CENTER_FRACTION * RADIUS_MM or one.center_factor == 1.0
    assert all(factor * size > CENTER_FRACTION * RADIUS_MM for factor in larger)
    assert one.residual_factor * 0.02 <= RESIDUAL_FRACTION * RADIUS_MM


def test_what_is_drawn_is_what_the_legend_says() -> None:
    axes = Figure().add_subplot()
    one = picture()
    draw_hole(axes, one)
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
    assert one.circle is not None
    distance = np.linalg.norm(contacts - one.circle.center_mm, axis=1)
    np.testing.assert_allclose(distance, RADIUS_MM + one.residual_factor * RESIDUAL_MM)


def test_without_truth_or_estimate_they_are_not_drawn(tmp_path: Path) -> None:
    axes = Figure().add_subplot()
    draw_hole(axes, picture(known=False))
    assert not any("true" in label for label in axes.get_legend_handles_labels()[1])
    axes = Figure().add_subplot()
    draw_hole(axes, HolePicture(circle=None, reading_mm=picture().reading_mm))
    assert axes.get_legend_handles_labels()[1] == ["readings, no estimate"]
    save_hole_plot(tmp_path / "hole.svg", "a title\nof two lines", picture())
    assert (tmp_path / "hole.svg").read_bytes().startswith(b"<?xml")
