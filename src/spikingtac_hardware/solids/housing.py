"""The printed parts of the sensor: base, shading plate, shell."""

from __future__ import annotations

from spikingtac_hardware.checks.mechanics import MARGIN_MM, boss_radius_mm
from spikingtac_hardware.layout import BAFFLE_WALL_MM, FIT_GAP_MM, POST_MM, Layout
from spikingtac_hardware.solids.cad import Solid
from spikingtac_hardware.solids.shapes import (
    box,
    common_volume_mm3,
    cylinder,
    cylinders,
    funnel,
    octagon,
    prism,
    square,
)

BOARD_LEDGE_MM = 1.0
"""Width on which the camera board rests, mm (ours)."""
TONGUE_MM = 0.8
"""Height and width of the plate's tongue, which centres the shell, mm (ours)."""
BEYOND_MM = 1.0
"""By which a cut reaches beyond the part, mm."""


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
