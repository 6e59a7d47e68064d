"""Checks of the printed parts, the boards and the fasteners."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from spikingtac_hardware.checks.finding import Finding, least, most
from spikingtac_hardware.layout import FIT_GAP_MM, POST_MM, Layout

LEDGE_BEARING_MM = 1.0
"""Least width on which the window rests, mm (ours: a bead of glue)."""
ENGAGED_DIAMETERS = 1.5
"""Least engagement of a screw in its insert, in thread diameters (textbook, brass)."""
TIP_ROOM_MM = 0.3
"""Least room between a screw's tip and the bottom of its hole, mm (ours)."""
RIM_BELOW_SKIN_MM = 1.0
"""Least height by which the gel stands free over the rim, mm (ours: what is touched first)."""
HOLDER_WALL_MM = 0.8
"""Wall of the lens holder, mm (class)."""
MARGIN_MM = 0.3
"""Least gap between parts that must not touch, mm (ours)."""
SHEET_GAP_MM = 0.05
"""Least gap to a bought sheet in its pocket, mm on each side (tolerance of laser cutting)."""


def mechanical_findings(layout: Layout) -> Iterator[Finding]:
    """Yield the findings on walls, pockets, boards and screws."""
    yield from _walls(layout)
    yield from _window(layout)
    yield from _boards(layout)
    yield from _screws(layout)


def _walls(layout: Layout) -> Iterator[Finding]:
    design, thinnest = layout.design, layout.design.printing.least_wall_mm
    rim = min(o - p for o, p in zip(layout.outer.half_mm, layout.pocket.half_mm, strict=True))
    yield least("shell.rim", f"a skin of {layout.window.size_mm[0]:g} mm in a housing of "
                f"{layout.outer.size_mm[0]:g} mm leaves a rim of", rim, thinnest)  # fmt: skip
    yield least("shell.wall", "the shell's wall is", design.housing.wall_mm, thinnest)
    yield least("base.floor", "the base's floor is", design.housing.floor_mm, thinnest)
    plate = layout.plate_top_mm - layout.base_top_mm - design.light.board_mm - FIT_GAP_MM
    yield least("plate.roof", "over the LED board the shading plate keeps", plate, thinnest)
    counterbore = (design.fasteners.head_mm[0] + design.fasteners.head_clearance_mm) / 2
    outside = design.fasteners.inset_mm - counterbore
    yield least("base.counterbore", "between a screw's head and the outer face the base keeps",
                outside, thinnest)  # fmt: skip
    inside = _to_cavity_mm(layout) - counterbore
    yield least("base.cavity", "between a screw's head and the board's space the base keeps",
                inside, thinnest)  # fmt: skip
    cut = design.fasteners.insert_hole_mm / 2
    yield least("shell.insert", "outside of an insert the shell keeps",
                design.fasteners.inset_mm - cut, design.fasteners.insert_wall_mm)  # fmt: skip


def _to_cavity_mm(layout: Layout) -> float:
    """Return the distance from a screw's axis to the space of the camera board, mm."""
    board, (x, y) = layout.design.board, layout.screw_places_mm[-1]
    half_x, half_y = (size / 2 + FIT_GAP_MM for size in board.size_mm)
    slanted = (x + y - half_x - half_y + board.chamfer_mm) / math.sqrt(2)
    return max(slanted, x - half_x, y - half_y)


def _window(layout: Layout) -> Iterator[Finding]:
    design = layout.design
    yield least("window.clearance", "the window's gap to the shell is",
                design.window.clearance_mm, SHEET_GAP_MM)  # fmt: skip
    yield least("window.ledge", "the window rests on a ledge of",
                design.housing.ledge_mm, LEDGE_BEARING_MM)  # fmt: skip
    free = layout.disc_mm + design.skin.cover_mm - layout.shell_top_mm
    yield least("skin.free", f"a rim of {design.housing.rim_mm:g} mm over the window lets the "
                "skin stand out by", free, RIM_BELOW_SKIN_MM)  # fmt: skip
    above = layout.ledge_bottom_mm - layout.slope_mm - layout.plate_top_mm
    pillar = design.fasteners.insert_hole_depth_mm + design.printing.least_wall_mm
    yield least("shell.height", "between plate and ledge the shell's pillars have",
                above, pillar)  # fmt: skip


def _boards(layout: Layout) -> Iterator[Finding]:
    design = layout.design
    board, thinnest = design.board, design.printing.least_wall_mm
    around = min(o - b / 2 for o, b in zip(layout.outer.half_mm, board.size_mm, strict=True))
    if layout.outer.kind == "round":
        corner = math.hypot(board.size_mm[0] / 2, board.size_mm[1] / 2 - board.chamfer_mm)
        around = layout.outer.half_mm[0] - corner
    yield least("board.wall", f"a camera board of {board.size_mm[0]:g} x {board.size_mm[1]:g} mm "
                "leaves the base a wall of", around - FIT_GAP_MM, thinnest)  # fmt: skip
    yield least("board.cable", "the slot for the cable has below the board",
                board.below_mm, design.housing.cable_mm[1])  # fmt: skip
    yield least("holder.height", "under the shading plate the lens holder has",
                layout.base_top_mm - layout.holder_top_mm, FIT_GAP_MM)  # fmt: skip
    beside = (board.holder_mm[0] - max(design.sensor.package_mm[:2])) / 2 - HOLDER_WALL_MM
    yield least("holder.width", "about the package the lens holder's room has on each side",
                beside, 0.0)  # fmt: skip
    yield least("board.posts", "outside of the posts of the plate the camera board has",
                _post_to_edge_mm(layout), 0.0)  # fmt: skip
    led_x = layout.design.light.place_mm - design.light.led_mm[1] / 2
    yield least("leds.inside", "between the opening of their board and the LEDs there are",
                led_x - layout.led_opening_half_mm, MARGIN_MM)  # fmt: skip
    yield least("leds.outside", "between the LEDs and the edge of their board there are",
                _led_to_edge_mm(layout), MARGIN_MM)  # fmt: skip
    yield least("leds.screws", "between an LED's window and a screw's boss the plate keeps",
                _led_to_boss_mm(layout), 0.0)  # fmt: skip
    yield least("leds.web", "between the windows of two LEDs the plate keeps",
                _web_mm(layout), design.printing.least_wall_mm)  # fmt: skip
    yield least("leds.below", "the shading plate's upper side is above the LEDs by",
                layout.plate_top_mm - layout.led_top_mm, MARGIN_MM)  # fmt: skip


def _post_to_edge_mm(layout: Layout) -> float:
    """Return the distance from a post to the straight or the cut edge of the board, mm."""
    board, place = layout.design.board, layout.post_places_mm[-1][0]
    straight = min(board.size_mm) / 2 - place
    slanted = (sum(board.size_mm) / 2 - board.chamfer_mm - 2 * place) / math.sqrt(2)
    return min(straight, slanted) - POST_MM / 2


def _led_to_edge_mm(layout: Layout) -> float:
    board = layout.led_board
    gaps = []
    for x, y, along_x in layout.led_places_mm:
        half_x, half_y = _led_half_mm(layout, along_x)
        far_x, far_y = abs(x) + half_x, abs(y) + half_y
        if board.kind == "round":
            gaps.append(board.half_mm[0] - math.hypot(far_x, far_y))
        else:
            gaps += [board.half_mm[0] - far_x, board.half_mm[1] - far_y]
    return min(gaps)


def _web_mm(layout: Layout) -> float:
    """Return the least distance of the windows of two LEDs, mm."""
    gaps = []
    for (x, y, along_x), (other_x, other_y, other_along_x) in combinations(layout.led_places_mm, 2):
        half_x, half_y = _led_half_mm(layout, along_x)
        other_half_x, other_half_y = _led_half_mm(layout, other_along_x)
        dx = abs(x - other_x) - half_x - other_half_x - 2 * MARGIN_MM
        dy = abs(y - other_y) - half_y - other_half_y - 2 * MARGIN_MM
        gaps.append(math.hypot(max(dx, 0.0), max(dy, 0.0)))
    return min(gaps)


def _led_half_mm(layout: Layout, along_x: bool) -> tuple[float, float]:
    length, width, _ = layout.design.light.led_mm
    return (length / 2, width / 2) if along_x else (width / 2, length / 2)


def _led_to_boss_mm(layout: Layout) -> float:
    gaps = []
    for x, y, along_x in layout.led_places_mm:
        half_x, half_y = _led_half_mm(layout, along_x)
        for sx, sy in layout.screw_places_mm:
            dx, dy = max(abs(sx - x) - half_x, 0.0), max(abs(sy - y) - half_y, 0.0)
            gaps.append(math.hypot(dx, dy) - boss_radius_mm(layout) - MARGIN_MM)
    return min(gaps)


def boss_radius_mm(layout: Layout) -> float:
    """Return the radius of the plate's bosses, on which the screws press, mm."""
    fasteners = layout.design.fasteners
    return fasteners.clearance_hole_mm / 2 + layout.design.printing.least_wall_mm


def _screws(layout: Layout) -> Iterator[Finding]:
    design, screws = layout.design, layout.design.fasteners
    yield least("screw.head", f"a counterbore of {screws.counterbore_mm:g} mm hides the head by",
                screws.counterbore_mm - screws.head_mm[1], 0.0)  # fmt: skip
    plain = layout.plate_top_mm - screws.counterbore_mm
    held = plain + design.holders.plate_mm
    for name, length, grip in (
        ("screw", screws.length_mm, plain),
        ("holder screw", screws.holder_length_mm, held),
    ):
        nearest = min(screws.lengths_mm, key=lambda listed, wanted=length: abs(listed - wanted))
        yield most(f"{name}.length", f"a {name} of {length:g} mm is away from the listed "
                   f"{nearest:g} mm by", abs(nearest - length), 0.0)  # fmt: skip
        inside = min(length - grip, screws.insert_length_mm)
        yield least(f"{name}.engagement", f"a {name} of {length:g} mm engages its insert by",
                    inside, ENGAGED_DIAMETERS * screws.thread_mm)  # fmt: skip
        room = screws.insert_hole_depth_mm - (length - grip)
        yield least(f"{name}.tip", f"a {name} of {length:g} mm leaves to the bottom of its hole",
                    room, TIP_ROOM_MM)  # fmt: skip
    yield least("insert.hole", "the hole for an insert is deeper than the insert by",
                screws.insert_hole_depth_mm - screws.insert_length_mm, TIP_ROOM_MM)  # fmt: skip
