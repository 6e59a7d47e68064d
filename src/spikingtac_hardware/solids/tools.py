"""What makes and what carries the sensor: mould and holders."""

from __future__ import annotations

import math

from spikingtac_hardware.layout import FIT_GAP_MM, Layout, Outline
from spikingtac_hardware.solids.cad import Solid, modeller
from spikingtac_hardware.solids.housing import BEYOND_MM
from spikingtac_hardware.solids.shapes import cylinder, cylinders, prism

VENT_MM = 1.5
"""Diameter of the lid's holes, through which air and spare silicone leave, mm (ours)."""
PUSH_MM = 8.0
"""Diameter of the hole in the tray's floor through which the window is pushed out, mm (ours)."""
DOWEL_HEIGHT_MM = 2.5
"""Height of the dowels, mm (ours)."""
SPIGOT_HEIGHT_MM = 3.0
"""Height of the flange's spigot, mm (the robot's recess is at least 6 mm deep)."""
SPIGOT_WALL_MM = 1.5
"""Wall of the spigot, mm (ours): the screws' heads lie inside of it."""


def tray(layout: Layout) -> Solid:
    """Return the tray: window, gel and cover, one above the other, with two dowels."""
    mould, skin = layout.design.mould, layout.design.skin
    room = layout.window.grown(layout.design.window.clearance_mm)
    depth = layout.design.window.thickness_mm + skin.gel_mm + skin.cover_mm
    top = mould.floor_mm + depth
    solid = prism(_mould_outline(layout), 0.0, top)
    solid += cylinders(mould.dowel_mm / 2, _dowels(layout), top - BEYOND_MM, top + DOWEL_HEIGHT_MM)
    solid -= prism(room, mould.floor_mm, top + DOWEL_HEIGHT_MM)
    return solid - cylinder(PUSH_MM / 2, (0.0, 0.0), -BEYOND_MM, mould.floor_mm + BEYOND_MM)


def lid(layout: Layout) -> Solid:
    """Return the lid.

    One side has a plug of the cover's thickness: with it the gel is cast. The other side is flat:
    with it the cover is cast over the discs.
    """
    mould, plug = layout.design.mould, layout.design.skin.cover_mm
    solid = prism(_mould_outline(layout), 0.0, mould.lid_mm)
    solid += prism(layout.window.grown(-FIT_GAP_MM), mould.lid_mm - BEYOND_MM, mould.lid_mm + plug)
    hole = mould.dowel_mm / 2 + layout.design.printing.clearance_mm
    solid -= cylinders(hole, _dowels(layout), -BEYOND_MM, mould.lid_mm + plug + BEYOND_MM)
    return solid - cylinders(VENT_MM / 2, _vents(layout), -BEYOND_MM, mould.lid_mm + 2 * BEYOND_MM)


def _mould_outline(layout: Layout) -> Outline:
    width, depth = layout.window.grown(layout.design.mould.wall_mm).size_mm
    return Outline("rectangle", (width, depth), 2.0)


def _dowels(layout: Layout) -> tuple[tuple[float, float], ...]:
    half_x, half_y = layout.window.half_mm
    away = layout.design.mould.wall_mm / 2
    return (-half_x - away, -half_y - away), (half_x + away, half_y + away)


def _vents(layout: Layout) -> tuple[tuple[float, float], ...]:
    half_x, half_y = (half - 2 * VENT_MM for half in layout.window.half_mm)
    if layout.window.kind == "round":
        half_x = half_y = half_x / math.sqrt(2)
    return tuple((sx * half_x, sy * half_y) for sy in (-1, 1) for sx in (-1, 1))


def gripper_holder(layout: Layout) -> Solid:
    """Return the plate between the sensor and a finger of a Robotiq 2F-85.

    The pattern of the finger's holes is a parameter to be measured, not a figure of the maker.
    """
    holders = layout.design.holders
    width, depth = layout.outer.size_mm
    length = max(holders.gripper_length_mm, depth)
    tail = length - depth
    outline = Outline("rectangle", (width, length), layout.design.housing.corner_radius_mm)
    solid = prism(outline, -holders.plate_mm, 0.0)
    solid = modeller().Pos(0, -tail / 2, 0) * solid
    middle = -depth / 2 - tail / 2
    half = holders.gripper_hole_pitch_mm / 2
    holes = ((-half, middle), (half, middle))
    solid -= cylinders(holders.gripper_hole_mm / 2, holes, -holders.plate_mm - BEYOND_MM, BEYOND_MM)
    return _without_screws(layout, solid, -holders.plate_mm)


def flange_holder(layout: Layout) -> Solid:
    """Return the flange after ISO 9409-1-50-4-M6, with the sensor on its upper side."""
    holders = layout.design.holders
    low = -holders.flange_thickness_mm
    solid = cylinder(holders.flange_mm / 2, (0.0, 0.0), low, 0.0)
    solid += cylinder(holders.flange_spigot_mm / 2, (0.0, 0.0), low - SPIGOT_HEIGHT_MM, low)
    room = holders.flange_spigot_mm / 2 - SPIGOT_WALL_MM
    solid -= cylinder(room, (0.0, 0.0), low - SPIGOT_HEIGHT_MM - BEYOND_MM, -holders.plate_mm)
    place = holders.flange_circle_mm / 2 / math.sqrt(2)
    bolts = tuple((sx * place, sy * place) for sy in (-1, 1) for sx in (-1, 1))
    solid -= cylinders(holders.flange_hole_mm / 2, bolts, low - BEYOND_MM, BEYOND_MM)
    return _without_screws(layout, solid, low - SPIGOT_HEIGHT_MM)


def _without_screws(layout: Layout, solid: Solid, bottom_mm: float) -> Solid:
    """Cut the holes and counterbores of the longer screws out of a holder."""
    screws, low = layout.design.fasteners, -layout.design.holders.plate_mm
    places = layout.screw_places_mm
    head = (screws.head_mm[0] + screws.head_clearance_mm) / 2
    below = bottom_mm - BEYOND_MM
    solid -= cylinders(screws.clearance_hole_mm / 2, places, below, BEYOND_MM)
    return solid - cylinders(head, places, below, low + screws.counterbore_mm)
