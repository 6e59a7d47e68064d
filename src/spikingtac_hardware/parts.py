"""The parts of a sensor: printed, bought, cut and cast, and the mould that casts its skin."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from spikingtac_hardware.checks import HOLDER_WALL_MM, MARGIN_MM, boss_radius_mm
from spikingtac_hardware.layout import BAFFLE_WALL_MM, FIT_GAP_MM, POST_MM, Layout, Outline
from spikingtac_hardware.solids import (
    Solid,
    box,
    common_volume_mm3,
    cylinder,
    cylinders,
    funnel,
    modeller,
    octagon,
    prism,
    square,
)

Made = Literal["printed", "bought", "cut", "cast", "tool"]

# Common volume below which two parts only touch, mm³ (rounding of the modeller).
TOUCHING_MM3 = 1e-4

# Thickness of a printed disc, mm: it lies in the cover (class: two passes of a screen).
PAINT_MM = 0.05
SOCKET_MM = 0.7  # Depth of the hexagon socket of a screw, mm (ISO 4762 M1.6, least value).
SOCKET_RADIUS_MM = 0.87  # Its radius across corners, mm (1.5 mm across flats).
FRONT_GLASS_MM = 0.3  # Depth of the front glass in the barrel, mm (drawing only).
BOARD_LEDGE_MM = 1.0  # Width on which the camera board rests, mm (ours).
TONGUE_MM = 0.8  # Height and width of the plate's tongue, which centres the shell, mm (ours).
BEYOND_MM = 1.0  # By which a cut reaches beyond the part, mm.
VENT_MM = 1.5  # Diameter of the lid's holes, through which air and spare silicone leave, mm (ours).

# Diameter of the hole in the tray's floor through which the window is pushed out, mm (ours).
PUSH_MM = 8.0
DOWEL_HEIGHT_MM = 2.5  # Height of the dowels, mm (ours).


def window(layout: Layout) -> Solid:
    """Return the acrylic window."""
    return prism(layout.window, layout.window_bottom_mm, layout.window_top_mm)


def gel(layout: Layout) -> Solid:
    """Return the clear gel."""
    return prism(layout.window, layout.window_top_mm, layout.disc_mm)


def cover(layout: Layout) -> Solid:
    """Return the opaque cover, without the discs that lie in it."""
    solid = prism(layout.window, layout.disc_mm, layout.design.housing.height_mm)
    return solid - discs(layout)


def discs(layout: Layout) -> Solid:
    """Return the discs."""
    radius = layout.design.skin.disc_diameter_mm / 2
    return cylinders(radius, layout.disc_places_mm, layout.disc_mm, layout.disc_mm + PAINT_MM)


def camera_board(layout: Layout) -> Solid:
    """Return the camera board."""
    board = layout.design.board
    return octagon(board.size_mm, board.chamfer_mm, layout.board_bottom_mm, layout.board_top_mm)


def package(layout: Layout) -> Solid:
    """Return the event sensor's package."""
    width, depth, height = layout.design.sensor.package_mm
    return box((width, depth), (0.0, 0.0), layout.board_top_mm, layout.board_top_mm + height)


def connector(layout: Layout) -> Solid:
    """Return the connector under the camera board."""
    width, height = layout.design.housing.cable_mm
    low = layout.board_bottom_mm - height
    place = (0.0, -layout.design.board.size_mm[1] / 4)
    return box((0.8 * width, 3.0), place, low, layout.board_bottom_mm)


def lens_holder(layout: Layout) -> Solid:
    """Return the lens holder: a square box over the package with a hole for the barrel."""
    design = layout.design
    width, _ = design.board.holder_mm
    low, top = layout.board_top_mm, layout.holder_top_mm
    room = width - 2 * HOLDER_WALL_MM
    depth = low + design.sensor.package_mm[2] + FIT_GAP_MM
    solid = box((width, width), (0.0, 0.0), low, top) - box((room, room), (0.0, 0.0), low, depth)
    return solid - cylinder(design.lens.barrel_mm / 2, (0.0, 0.0), low, top + FIT_GAP_MM)


def lens(layout: Layout) -> Solid:
    """Return the lens's barrel, with the front glass as a hollow."""
    barrel = layout.design.lens.barrel_mm / 2
    low = layout.board_top_mm + layout.design.sensor.package_mm[2] + FIT_GAP_MM
    solid = cylinder(barrel, (0.0, 0.0), low, layout.lens_front_mm)
    front = layout.lens_front_mm
    return solid - cylinder(barrel / 2, (0.0, 0.0), front - FRONT_GLASS_MM, front)


def leds(layout: Layout) -> Solid:
    """Return the LEDs on their board."""
    light = layout.design.light
    low = layout.base_top_mm + light.board_mm
    length, width, _ = light.led_mm
    bodies = [
        box((length, width) if along_x else (width, length), (x, y), low, layout.led_top_mm)
        for x, y, along_x in layout.led_places_mm
    ]
    return modeller().Compound(bodies)


def screws(layout: Layout) -> Solid:
    """Return the four screws; their thread is a plain cylinder."""
    one = layout.design.fasteners
    head, seat = one.head_mm, one.counterbore_mm
    thread = cylinders(one.thread_mm / 2, layout.screw_places_mm, seat, seat + one.length_mm)
    heads = cylinders(head[0] / 2, layout.screw_places_mm, seat - head[1], seat)
    low = seat - head[1]
    sockets = cylinders(SOCKET_RADIUS_MM, layout.screw_places_mm, low, low + SOCKET_MM)
    return heads + thread - sockets


def inserts(layout: Layout) -> Solid:
    """Return the four inserts as they sit in the plastic that they have melted into."""
    one, low = layout.design.fasteners, layout.plate_top_mm
    high = low + one.insert_length_mm
    body = cylinders(one.insert_hole_mm / 2, layout.screw_places_mm, low, high)
    return body - cylinders(one.thread_mm / 2, layout.screw_places_mm, low, high)


def base(layout: Layout) -> Solid:
    """Return the base: board space, cable slot, holes and counterbores for the screws."""
    design = layout.design
    board, screws = design.board, design.fasteners
    floor, top = design.housing.floor_mm, layout.base_top_mm
    width, depth = board.size_mm
    room = width + 2 * FIT_GAP_MM, depth + 2 * FIT_GAP_MM
    below = width - 2 * BOARD_LEDGE_MM, depth - 2 * BOARD_LEDGE_MM
    slot_mm = layout.outer.size_mm[1] / 2
    solid = prism(layout.outer, 0.0, top)
    solid -= octagon(room, board.chamfer_mm, layout.board_bottom_mm, top + BEYOND_MM)
    solid -= octagon(below, board.chamfer_mm, floor, top)
    solid -= box((design.housing.cable_mm[0], slot_mm), (0.0, -layout.outer.size_mm[1] / 2),
                 floor, floor + design.housing.cable_mm[1])  # fmt: skip
    places = layout.screw_places_mm
    solid -= cylinders(screws.clearance_hole_mm / 2, places, -BEYOND_MM, top + BEYOND_MM)
    head = (screws.head_mm[0] + screws.head_clearance_mm) / 2
    return solid - cylinders(head, places, -BEYOND_MM, screws.counterbore_mm)


def plate(layout: Layout) -> Solid:
    """Return the shading plate: pocket for the LED board, windows, rim about the lens, posts."""
    design = layout.design
    low, top = layout.base_top_mm, layout.plate_top_mm
    solid = prism(layout.outer, low, top)
    pocket = prism(layout.led_board.grown(FIT_GAP_MM), low - BEYOND_MM,
                   low + design.light.board_mm + FIT_GAP_MM)  # fmt: skip
    solid -= pocket - cylinders(boss_radius_mm(layout), layout.screw_places_mm, 0.0, top)
    solid += _tongue(layout)
    rim = layout.baffle_radius_mm + BAFFLE_WALL_MM
    solid += cylinder(rim, (0.0, 0.0), top - design.housing.plate_mm / 2, layout.baffle_top_mm)
    solid += cylinders(
        POST_MM / 2,
        layout.post_places_mm,
        layout.board_top_mm + FIT_GAP_MM / 2,
        top - design.housing.plate_mm / 2,
    )
    solid -= cylinder(layout.baffle_radius_mm, (0.0, 0.0), low - BEYOND_MM,
                      layout.baffle_top_mm + BEYOND_MM)  # fmt: skip
    solid -= cylinders(design.fasteners.clearance_hole_mm / 2, layout.screw_places_mm,
                       low - BEYOND_MM, top + BEYOND_MM)  # fmt: skip
    for window in _led_windows(layout, 0.0):
        solid -= window
    return solid


def _led_windows(layout: Layout, more_mm: float) -> list[Solid]:
    """Return the windows over the LEDs, wider by ``more_mm`` on each side."""
    low, top = layout.base_top_mm - BEYOND_MM, layout.plate_top_mm + TONGUE_MM + BEYOND_MM
    length, width = (one + 2 * (MARGIN_MM + more_mm) for one in layout.design.light.led_mm[:2])
    return [
        box((length, width) if along_x else (width, length), (x, y), low, top)
        for x, y, along_x in layout.led_places_mm
    ]


def _tongue(layout: Layout) -> Solid:
    outside = layout.cavity.grown(-layout.design.printing.clearance_mm)
    low, high = layout.plate_top_mm - BEYOND_MM / 2, layout.plate_top_mm + TONGUE_MM
    ring = prism(outside, low, high) - prism(outside.grown(-TONGUE_MM), low, high)
    # Where a window reaches into the tongue the tongue ends: no slivers beside the window.
    windows = zip(_led_windows(layout, 0.0), _led_windows(layout, TONGUE_MM), strict=True)
    for window, wider in windows:
        if common_volume_mm3(ring, window) > 0:
            ring -= wider
    gap = layout.pillar_radius_mm + 2 * layout.design.printing.clearance_mm
    return ring - cylinders(gap, layout.screw_places_mm, layout.plate_top_mm, high + BEYOND_MM)


def shell(layout: Layout) -> Solid:
    """Return the shell: ledge for the window, pillars with holes for the inserts."""
    screws = layout.design.fasteners
    low, ledge = layout.plate_top_mm, layout.ledge_bottom_mm
    depth = low + screws.insert_hole_depth_mm
    room = prism(layout.cavity, low - BEYOND_MM, ledge - layout.slope_mm)
    room += funnel(layout.cavity, ledge - layout.slope_mm, layout.opening, ledge)
    pillars = cylinders(layout.pillar_radius_mm, layout.screw_places_mm, low - BEYOND_MM,
                        depth + layout.design.printing.least_wall_mm)  # fmt: skip
    solid = prism(layout.outer, low, layout.shell_top_mm) - (room - pillars)
    solid -= prism(layout.opening, ledge - BEYOND_MM / 2, layout.shell_top_mm)
    solid -= prism(layout.pocket, layout.window_bottom_mm, layout.shell_top_mm + BEYOND_MM)
    holes = cylinders(screws.insert_hole_mm / 2, layout.screw_places_mm, low - BEYOND_MM, depth)
    return solid - holes


def led_board(layout: Layout) -> Solid:
    """Return the LED board: a frame on the base, cut out about the screws' bosses."""
    low = layout.base_top_mm
    high = low + layout.design.light.board_mm
    frame = prism(layout.led_board, low, high)
    frame -= prism(square(layout.led_opening_half_mm), low - BEYOND_MM, high + BEYOND_MM)
    gap = boss_radius_mm(layout) + FIT_GAP_MM
    return frame - cylinders(gap, layout.screw_places_mm, low - BEYOND_MM, high + BEYOND_MM)


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


# The parts from below to above: name, kind, function.
_SENSOR: tuple[tuple[str, Made, Callable[[Layout], Solid]], ...] = (
    ("screws", "bought", screws),
    ("base", "printed", base),
    ("connector", "bought", connector),
    ("camera-board", "bought", camera_board),
    ("event-sensor", "bought", package),
    ("lens-holder", "bought", lens_holder),
    ("lens", "bought", lens),
    ("led-board", "bought", led_board),
    ("leds", "bought", leds),
    ("shading-plate", "printed", plate),
    ("inserts", "bought", inserts),
    ("shell", "printed", shell),
    ("window", "cut", window),
    ("gel", "cast", gel),
    ("discs", "cast", discs),
    ("cover", "cast", cover),
)

_TOOLS: tuple[tuple[str, Callable[[Layout], Solid]], ...] = (
    ("mould-tray", tray),
    ("mould-lid", lid),
)


def sensor_parts(layout: Layout) -> tuple[Part, ...]:
    """Return the parts of the sensor from below to above, each in its place."""
    return tuple(Part(name, made, solid(layout)) for name, made, solid in _SENSOR)


def tool_parts(layout: Layout) -> tuple[Part, ...]:
    """Return the two halves of the mould of the skin."""
    return tuple(Part(name, "tool", solid(layout)) for name, solid in _TOOLS)


def interferences(parts: Sequence[Part]) -> dict[tuple[str, str], float]:
    """Return the common volume of each pair of parts that overlap, mm³."""
    found = {}
    for one, other in combinations(parts, 2):
        volume = common_volume_mm3(one.solid, other.solid)
        if volume > TOUCHING_MM3:
            found[one.name, other.name] = volume
    return found
