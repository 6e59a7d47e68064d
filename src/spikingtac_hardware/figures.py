"""The figures of a design, by name, with their units in the names."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from spikingtac_hardware.layout import Layout
from spikingtac_hardware.light import light_figures
from spikingtac_hardware.optics import Imaging
from spikingtac_hardware.parameters.design import Design

SHARP_PX = 1.0
"""Blur disc up to which the skin counts as sharp, px."""
SEARCH_MM = np.linspace(0.0, 5.0, 501)
"""Indentations at which sharpness is looked up, mm."""


def figures_of(design: Design) -> dict[str, Any]:
    """Return what follows from the parameters of a design that passes its checks.

    Example:
        >>> from spikingtac_hardware.parameters.design import load_design
        >>> round(figures_of(load_design())["pitch_px"], 1)
        37.2
    """
    layout = Layout(design)
    imaging = Imaging(layout)
    skin, field = design.skin, imaging.field_mm
    area = _sensing_area_mm2(layout, field)
    width, depth = layout.outer.size_mm
    volume = layout.outer.area_mm2 * design.housing.height_mm
    sharp = [press for press in SEARCH_MM if imaging.blur_px(press) <= SHARP_PX]
    return {
        "size_mm": [width, depth, design.housing.height_mm],
        "volume_mm3": volume,
        "sensing_area_mm": [min(s, f) for s, f in zip(skin.size_mm, field, strict=True)],
        "sensing_area_mm2": area,
        "depth_over_area_mm": volume / area,
        "markers": skin.grid[0] * skin.grid[1],
        "px_per_mm": imaging.px_per_mm,
        "pitch_px": skin.pitch_mm * imaging.px_per_mm,
        "disc_radius_px": skin.disc_diameter_mm / 2 * imaging.px_per_mm,
        "field_mm": list(field),
        "magnification": imaging.magnification,
        "working_distance_mm": layout.disc_mm - layout.lens_front_mm,
        "reduced_distance_mm": imaging.reduced_mm,
        "corner_angle_deg": imaging.corner_angle_deg,
        "distortion_at_outer_disc": _distortion(layout, imaging),
        "blur_at_deepest_press_px": imaging.blur_px(skin.deepest_press_mm),
        "sharp_to_indentation_mm": float(max(sharp)),
        "twin_lens": asdict(imaging.twin_lens()),
        **asdict(light_figures(layout, imaging)),
    }


def _sensing_area_mm2(layout: Layout, field_mm: tuple[float, float]) -> float:
    """Return the area of the skin that the sensor sees, a rectangle or a circle."""
    width, depth = (min(s, f) for s, f in zip(layout.window.size_mm, field_mm, strict=True))
    return float(np.pi / 4 * width * depth) if layout.window.kind == "round" else width * depth


def _distortion(layout: Layout, imaging: Imaging) -> float:
    reach = np.array([layout.disc_reach_mm])
    return float(imaging.image_px(reach)[0] / (reach[0] * imaging.px_per_mm) - 1)
