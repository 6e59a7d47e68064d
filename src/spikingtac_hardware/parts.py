"""The parts of a sensor as solids: printed, bought, cut and cast, and the mould of its skin.

All lengths are mm. Solids need the extra ``[design]``.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, Literal

from spikingtac.errors import import_extra
from spikingtac_hardware.checks import HOLDER_WALL_MM, MARGIN_MM
from spikingtac_hardware.layout import (
    BAFFLE_WALL_MM,
    FIT_GAP_MM,
    POST_MM,
    SMALL_RADIUS_MM,
    Layout,
    Outline,
    Place,
    corners,
)

Made = Literal["printed", "bought", "cut", "cast", "tool"]
Solid = Any  # A solid of build123d; the library is optional, so that its types are not named.
TOUCHING_MM = 1e-5  # Overlap of bounding boxes that only touch, mm (rounding of the modeller).
AXIS: Place = (0.0, 0.0)

# Common volume below which two parts only touch, mm³ (rounding of the modeller).
TOUCHING_MM3 = 1e-4

# Thickness of a printed disc, mm: it lies in the cover (class: two passes of a screen).
PAINT_MM = 0.05
SOCKET_MM = 0.7  # Depth of the hexagon socket of a screw, mm (ISO 4762 M1.6, least value).
SOCKET_RADIUS_MM = 0.87  # Its radius across corners, mm (1.5 mm across flats).
FRONT_GLASS_MM = 0.3  # Depth of the front glass in the barrel, mm (drawing only).
BOARD_LEDGE_MM = 1.0  # Width on which the camera board rests, mm.
TONGUE_MM = 0.8  # Height and width of the plate's tongue, which centres the shell, mm.
BEYOND_MM = 1.0  # By which a cut reaches beyond the part, mm.
VENT_MM = 1.5  # Diameter of the lid's holes, through which air and spare silicone leave, mm.

# Diameter of the hole in the tray's floor through which the window is pushed out, mm.
PUSH_MM = 8.0
DOWEL_HEIGHT_MM = 2.5  # Height of the dowels, mm.


@dataclass(frozen=True, slots=True)
class Part:
    """One part in its place.

    Attributes:
        name: Its name, also of its files.
        made: ``printed``, ``bought``, ``cut`` from sheet, ``cast``, or ``tool`` (printed, and no
            part of the sensor).
        solid: Its solid, mm.
    """

    name: str
    made: Made
    solid: Solid


def sensor_parts(layout: Layout) -> tuple[Part, ...]:
    """Return the parts of the sensor from below to above, each in its place."""
    solids = {
        "screws": _screws(layout), "base": _base(layout), "lens-holder": _lens_holder(layout),
        "led-board": _led_board(layout), "shading-plate": _plate(layout), "shell": _shell(layout),
    } | _bought(layout) | _skin(layout)  # fmt: skip
    return tuple(Part(name, made, solids[name]) for name, made in SENSOR.items())


def tool_parts(layout: Layout) -> tuple[Part, ...]:
    """Return the two halves of the mould of the skin."""
    return Part("mould-tray", "tool", _tray(layout)), Part("mould-lid", "tool", _lid(layout))


def interferences(parts: Sequence[Part]) -> dict[tuple[str, str], float]:
    """Return the common volume of each pair of parts that overlap, mm³."""
    volumes = {
        (one.name, other.name): common_volume_mm3(one.solid, other.solid)
        for one, other in combinations(parts, 2)
    }
    return {pair: volume for pair, volume in volumes.items() if volume > TOUCHING_MM3}


def _screws(layout: Layout) -> Solid:
    """Return the four screws; their thread is a plain cylinder."""
    one, places = layout.design.fasteners, layout.screw_places_mm
    head, seat = one.head_mm, one.counterbore_mm
    low = seat - head[1]
    solid = cylinders(head[0] / 2, places, low, seat)
    solid += cylinders(one.thread_mm / 2, places, seat, seat + one.length_mm)
    return solid - cylinders(SOCKET_RADIUS_MM, places, low, low + SOCKET_MM)


def _base(layout: Layout) -> Solid:
    """Return the base: board space, cable slot, holes and counterbores for the screws."""
    design, places = layout.design, layout.screw_places_mm
    board, screws = design.board, design.fasteners
    floor, top = design.housing.floor_mm, layout.base_top_mm
    width, depth = board.size_mm
    room = width + 2 * FIT_GAP_MM, depth + 2 * FIT_GAP_MM
    below = width - 2 * BOARD_LEDGE_MM, depth - 2 * BOARD_LEDGE_MM
    half, (slot, high) = layout.outer.size_mm[1] / 2, design.housing.cable_mm
    solid = prism(layout.outer, 0.0, top)
    solid -= octagon(room, board.chamfer_mm, layout.board_bottom_mm, top + BEYOND_MM)
    solid -= octagon(below, board.chamfer_mm, floor, top)
    solid -= box((slot, half), (0.0, -half), floor, floor + high)
    solid -= cylinders(screws.clearance_hole_mm / 2, places, -BEYOND_MM, top + BEYOND_MM)
    head = (screws.head_mm[0] + screws.head_clearance_mm) / 2
    return solid - cylinders(head, places, -BEYOND_MM, screws.counterbore_mm)


def _lens_holder(layout: Layout) -> Solid:
    """Return the lens holder: a square box over the package with a hole for the barrel."""
    design, low, top = layout.design, layout.board_top_mm, layout.holder_top_mm
    width = design.board.holder_mm[0]
    room, depth = width - 2 * HOLDER_WALL_MM, low + design.sensor.package_mm[2] + FIT_GAP_MM
    solid = box((width, width), AXIS, low, top) - box((room, room), AXIS, low, depth)
    return solid - cylinders(design.lens.barrel_mm / 2, [AXIS], low, top + FIT_GAP_MM)


def _led_board(layout: Layout) -> Solid:
    """Return the LED board: a frame on the base, cut out about the screws' bosses."""
    low = layout.base_top_mm
    high = low + layout.design.light.board_mm
    frame = prism(layout.led_board, low, high)
    frame -= prism(square(layout.led_opening_half_mm), low - BEYOND_MM, high + BEYOND_MM)
    gap = layout.boss_radius_mm + FIT_GAP_MM
    return frame - cylinders(gap, layout.screw_places_mm, low - BEYOND_MM, high + BEYOND_MM)


def _plate(layout: Layout) -> Solid:
    """Return the shading plate: pocket for the LED board, windows, rim about the lens, posts."""
    design, screws = layout.design, layout.screw_places_mm
    low, top, rim_top = layout.base_top_mm, layout.plate_top_mm, layout.baffle_top_mm
    beneath, middle = low - BEYOND_MM, top - design.housing.plate_mm / 2
    solid = prism(layout.outer, low, top)
    pocket = layout.led_board.grown(FIT_GAP_MM)
    pocket_top = low + design.light.board_mm + FIT_GAP_MM
    cut = prism(pocket, beneath, pocket_top)
    solid -= cut - cylinders(layout.boss_radius_mm, screws, 0.0, top)
    solid += _tongue(layout)
    rim = layout.baffle_radius_mm + BAFFLE_WALL_MM
    solid += cylinders(rim, [AXIS], middle, rim_top)
    foot = layout.board_top_mm + FIT_GAP_MM / 2
    solid += cylinders(POST_MM / 2, layout.post_places_mm, foot, middle)
    solid -= cylinders(layout.baffle_radius_mm, [AXIS], beneath, rim_top + BEYOND_MM)
    hole = design.fasteners.clearance_hole_mm / 2
    solid -= cylinders(hole, screws, beneath, top + BEYOND_MM)
    for window in _led_windows(layout, MARGIN_MM):
        solid -= window
    return solid


def _led_windows(layout: Layout, more_mm: float) -> list[Solid]:
    """Return the windows over the LEDs, wider than these by ``more_mm`` on each side."""
    low, top = layout.base_top_mm - BEYOND_MM, layout.plate_top_mm + TONGUE_MM + BEYOND_MM
    return [box(size, place, low, top) for place, size in layout.led_boxes_mm(more_mm)]


def _tongue(layout: Layout) -> Solid:
    clearance = layout.design.printing.clearance_mm
    outside = layout.cavity.grown(-clearance)
    low, high = layout.plate_top_mm - BEYOND_MM / 2, layout.plate_top_mm + TONGUE_MM
    ring = prism(outside, low, high) - prism(outside.grown(-TONGUE_MM), low, high)
    # Where a window reaches into the tongue the tongue ends: no slivers beside the window.
    wider = _led_windows(layout, MARGIN_MM + TONGUE_MM)
    for window, cut in zip(_led_windows(layout, MARGIN_MM), wider, strict=True):
        if common_volume_mm3(ring, window) > 0:
            ring -= cut
    gap = layout.pillar_radius_mm + 2 * clearance
    return ring - cylinders(gap, layout.screw_places_mm, layout.plate_top_mm, high + BEYOND_MM)


def _shell(layout: Layout) -> Solid:
    """Return the shell: ledge for the window, pillars with holes for the inserts."""
    screws, places = layout.design.fasteners, layout.screw_places_mm
    low, ledge, top = layout.plate_top_mm, layout.ledge_bottom_mm, layout.shell_top_mm
    beneath, slope, cad = low - BEYOND_MM, ledge - layout.slope_mm, modeller()
    room = prism(layout.cavity, beneath, slope)
    ends = cad.Pos(0, 0, slope) * face(layout.cavity), cad.Pos(0, 0, ledge) * face(layout.opening)
    room += cad.loft(list(ends))
    pillars = cylinders(layout.pillar_radius_mm, places, beneath, layout.pillar_top_mm)
    solid = prism(layout.outer, low, top) - (room - pillars)
    solid -= prism(layout.opening, ledge - BEYOND_MM / 2, top)
    solid -= prism(layout.pocket, layout.window_bottom_mm, top + BEYOND_MM)
    depth = low + screws.insert_hole_depth_mm
    return solid - cylinders(screws.insert_hole_mm / 2, places, beneath, depth)


def _bought(layout: Layout) -> dict[str, Solid]:
    """Return what is bought, but for lens holder, LED board and screws."""
    design, board, place = layout.design, layout.design.board, layout.screw_places_mm
    low, high = layout.board_bottom_mm, layout.board_top_mm
    width, height = design.housing.cable_mm
    plug = box((0.8 * width, 3.0), (0.0, -board.size_mm[1] / 4), low - height, low)
    *size, thick = design.sensor.package_mm
    barrel, front = design.lens.barrel_mm / 2, layout.lens_front_mm
    lens = cylinders(barrel, [AXIS], high + thick + FIT_GAP_MM, front)
    glass = cylinders(barrel / 2, [AXIS], front - FRONT_GLASS_MM, front)
    lamp, top = layout.base_top_mm + design.light.board_mm, layout.led_top_mm
    screws, foot = design.fasteners, layout.plate_top_mm
    # The inserts as they sit in the plastic that they have melted into.
    insert, bore = (
        cylinders(across / 2, place, foot, foot + screws.insert_length_mm)
        for across in (screws.insert_hole_mm, screws.thread_mm)
    )
    return {
        "connector": plug,
        "camera-board": octagon(board.size_mm, board.chamfer_mm, low, high),
        "event-sensor": box(tuple(size), AXIS, high, high + thick),
        "lens": lens - glass,
        "leds": modeller().Compound([box(s, at, lamp, top) for at, s in layout.led_boxes_mm()]),
        "inserts": insert - bore,
    }


def _skin(layout: Layout) -> dict[str, Solid]:
    """Return window, gel, discs, and the opaque cover without the discs that lie in it."""
    skin, disc_mm = layout.design.skin, layout.disc_mm
    levels = (
        layout.window_bottom_mm,
        layout.window_top_mm,
        disc_mm,
        layout.design.housing.height_mm,
    )
    window, gel, cover = (prism(layout.window, *pair) for pair in pairwise(levels))
    radius = skin.disc_diameter_mm / 2
    discs = cylinders(radius, layout.disc_places_mm, disc_mm, disc_mm + PAINT_MM)
    return {"window": window, "gel": gel, "discs": discs, "cover": cover - discs}


# The parts from below to above, and how each is made.
SENSOR: dict[str, Made] = {
    "screws": "bought", "base": "printed", "connector": "bought", "camera-board": "bought",
    "event-sensor": "bought", "lens-holder": "bought", "lens": "bought", "led-board": "bought",
    "leds": "bought", "shading-plate": "printed", "inserts": "bought", "shell": "printed",
    "window": "cut", "gel": "cast", "discs": "cast", "cover": "cast",
}  # fmt: skip


def _tray(layout: Layout) -> Solid:
    """Return the tray: window, gel and cover, one above the other, with two dowels."""
    mould, skin, window = layout.design.mould, layout.design.skin, layout.design.window
    top = mould.floor_mm + window.thickness_mm + skin.gel_mm + skin.cover_mm
    high = top + DOWEL_HEIGHT_MM
    solid = prism(_mould_outline(layout), 0.0, top)
    solid += cylinders(mould.dowel_mm / 2, _dowels(layout), top - BEYOND_MM, high)
    solid -= prism(layout.window.grown(window.clearance_mm), mould.floor_mm, high)
    return solid - cylinders(PUSH_MM / 2, [AXIS], -BEYOND_MM, mould.floor_mm + BEYOND_MM)


def _lid(layout: Layout) -> Solid:
    """Return the lid.

    One side has a plug of the cover's thickness: with it the gel is cast. The other side is flat:
    with it the cover is cast over the discs.
    """
    mould, plug = layout.design.mould, layout.design.skin.cover_mm
    top = mould.lid_mm + plug
    solid = prism(_mould_outline(layout), 0.0, mould.lid_mm)
    solid += prism(layout.window.grown(-FIT_GAP_MM), mould.lid_mm - BEYOND_MM, top)
    hole = mould.dowel_mm / 2 + layout.design.printing.clearance_mm
    solid -= cylinders(hole, _dowels(layout), -BEYOND_MM, top + BEYOND_MM)
    half_x, half_y = (half - 2 * VENT_MM for half in layout.window.half_mm)
    if layout.window.kind == "round":
        half_x = half_y = half_x / math.sqrt(2)
    vents = corners(half_x, half_y)
    return solid - cylinders(VENT_MM / 2, vents, -BEYOND_MM, mould.lid_mm + 2 * BEYOND_MM)


def _mould_outline(layout: Layout) -> Outline:
    return Outline("rectangle", layout.window.grown(layout.design.mould.wall_mm).size_mm, 2.0)


def _dowels(layout: Layout) -> tuple[Place, ...]:
    away = layout.design.mould.wall_mm / 2
    x, y = (half + away for half in layout.window.half_mm)
    return (-x, -y), (x, y)


def modeller(name: str = "build123d") -> Any:
    """Return the module build123d, or the one of another name.

    Raises:
        MissingExtraError: The extra ``[design]`` is not installed.
    """
    return import_extra(
        name, "a design's folder (its figures alone do not: leave -o away)", "design"
    )


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


def cylinders(radius_mm: float, places: Iterable[Place], low_mm: float, high_mm: float) -> Solid:
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
