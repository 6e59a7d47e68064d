"""The parts that are bought, cut or cast, as plain bodies."""

from __future__ import annotations

from spikingtac_hardware.checks.mechanics import HOLDER_WALL_MM
from spikingtac_hardware.layout import FIT_GAP_MM, Layout
from spikingtac_hardware.solids.cad import Solid, modeller
from spikingtac_hardware.solids.shapes import box, cylinder, cylinders, octagon, prism

PAINT_MM = 0.05
"""Thickness of a printed disc, mm: it lies in the cover (class: two passes of a screen)."""
SOCKET_MM = 0.7
"""Depth of the hexagon socket of a screw, mm (ISO 4762 M1.6, least value)."""
SOCKET_RADIUS_MM = 0.87
"""Its radius across corners, mm (1.5 mm across flats)."""
FRONT_GLASS_MM = 0.3
"""Depth of the front glass in the barrel, mm (drawing only)."""


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
