"""Solids of the parts: shapes between two heights, in mm; needs the extra ``[design]``."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

from spikingtac.errors import MissingExtraError
from spikingtac_hardware.layout import SMALL_RADIUS_MM, Outline, Place

Solid = Any  # A solid of build123d; the library is optional, so that its types are not named.
Places = Iterable[Place]
TOUCHING_MM = 1e-5  # Overlap of bounding boxes that only touch, mm (rounding of the modeller).
AXIS: Place = (0.0, 0.0)


def modeller(name: str = "build123d") -> Any:
    """Return the module build123d, or the one of another name.

    Raises:
        MissingExtraError: The extra ``[design]`` is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"solids and drawings need {name}: pip install 'spikingtac[design]' "
            "(figures and checks need nothing more: leave -o away)"
        ) from error


def prism(outline: Outline, low_mm: float, high_mm: float) -> Solid:
    """Return an outline, extruded from one height to another."""
    cad = modeller()
    lifted = cad.Pos(0, 0, low_mm) * face(outline)
    return cad.extrude(lifted, high_mm - low_mm, dir=(0, 0, 1))


def face(outline: Outline) -> Solid:
    """Return an outline as a flat face at height 0."""
    cad = modeller()
    if outline.kind == "round":
        return cad.Circle(outline.half_mm[0])
    return cad.RectangleRounded(*outline.size_mm, min(outline.radius_mm, *outline.half_mm) * 0.999)


def funnel(low: Outline, low_mm: float, high: Outline, high_mm: float) -> Solid:
    """Return the solid between an outline at one height and another one above it."""
    cad = modeller()
    return cad.loft([cad.Pos(0, 0, low_mm) * face(low), cad.Pos(0, 0, high_mm) * face(high)])


def cylinders(radius_mm: float, places: Places, low_mm: float, high_mm: float) -> Solid:
    """Return equal upright cylinders at one place or more, as one compound."""
    cad = modeller()
    one, middle = cad.Cylinder(radius_mm, high_mm - low_mm), (low_mm + high_mm) / 2
    return cad.Compound([cad.Pos(*place, middle) * one for place in places])


def box(size: tuple[float, float], place: Place, low_mm: float, high_mm: float) -> Solid:
    """Return an upright box about a place, mm."""
    cad = modeller()
    return cad.Pos(*place, (low_mm + high_mm) / 2) * cad.Box(*size, high_mm - low_mm)


def octagon(size: tuple[float, float], chamfer_mm: float, low_mm: float, high_mm: float) -> Solid:
    """Return a box about the axis whose upright edges are cut, mm."""
    cad = modeller()
    solid = box(size, AXIS, low_mm, high_mm)
    return cad.chamfer(solid.edges().filter_by(cad.Axis.Z), chamfer_mm)


def square(half_mm: float) -> Outline:
    """Return a square outline of a half-width, mm."""
    return Outline("rectangle", (2 * half_mm, 2 * half_mm), SMALL_RADIUS_MM)


def common_volume_mm3(one: Solid, other: Solid) -> float:
    """Return the volume that two solids share, mm³; first their bounding boxes are compared."""
    a, b = one.bounding_box(), other.bounding_box()
    for axis in "XYZ":
        high = min(getattr(a.max, axis), getattr(b.max, axis))
        if high <= max(getattr(a.min, axis), getattr(b.min, axis)) + TOUCHING_MM:
            return 0.0
    common = one.intersect(other)
    return 0.0 if common is None else float(sum(part.volume for part in common.solids()))
