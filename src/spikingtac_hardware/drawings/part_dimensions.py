"""Which dimensions a drawing shows of each printed part, in the coordinates of its views."""

from __future__ import annotations

from collections.abc import Mapping

from spikingtac_hardware.drawings.dimensions import Dimension
from spikingtac_hardware.drawings.sheet import Face
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.solids.housing import TONGUE_MM
from spikingtac_hardware.solids.tools import SPIGOT_HEIGHT_MM

NEAR_MM, NEXT_MM, FAR_MM = 6.0, 12.0, 18.0
"""Distances of dimension lines from the part, on paper, mm."""

Views = Mapping[Face, list[Dimension]]


def dimensions_of(name: str, layout: Layout) -> Views:
    """Return the dimensions of a printed part, by view.

    Args:
        name: Name of the part.
        layout: Its measures.
    """
    return _VIEWS[name](layout)


def _level(half: float, y: float, away: float, text: str = "") -> Dimension:
    return Dimension((-half, y), (half, y), away, text or f"{2 * half:g}")


def _tall(x: float, low: float, high: float, away: float, text: str = "") -> Dimension:
    return Dimension((x, low), (x, high), away, text or f"{high - low:.4g}", upright=True)


def _screws(layout: Layout, edge: float, what: str) -> list[Dimension]:
    """Return the distances of the screws from each other, above a view, and their holes' size."""
    x, y = layout.screw_places_mm[-1]
    right = layout.outer.half_mm[0]
    return [
        _level(x, edge, NEAR_MM, f"{2 * x:.4g}  (4 × {what})"),
        _tall(right, -y, y, NEAR_MM),
    ]


def _base(layout: Layout) -> Views:
    (half_x, half_y), screws = layout.outer.half_mm, layout.design.fasteners
    board = layout.design.board
    room = board.size_mm[0] / 2 + 0.1
    head = screws.head_mm[0] + screws.head_clearance_mm
    slot = layout.design.housing.cable_mm
    floor = layout.design.housing.floor_mm
    return {
        "front": [
            _level(half_x, 0.0, -NEXT_MM),
            _tall(half_x, 0.0, layout.base_top_mm, FAR_MM - 4),
            _tall(half_x, 0.0, floor, NEAR_MM - 2),
            _tall(half_x, floor, layout.board_bottom_mm, NEAR_MM - 2),
            _level(slot[0] / 2, 0.0, -NEAR_MM, f"slot {slot[0]:g} × {slot[1]:g}"),
            _level(room, layout.base_top_mm, NEAR_MM),
        ],
        "below": [
            *_screws(layout, half_y,
                     f"⌀{screws.clearance_hole_mm:g}, ⌀{head:g} × {screws.counterbore_mm:g}"),
            _tall(half_x, -half_y, half_y, FAR_MM),
        ],
    }  # fmt: skip


def _plate(layout: Layout) -> Views:
    (half_x, half_y), light = layout.outer.half_mm, layout.design.light
    low, top = layout.base_top_mm, layout.plate_top_mm
    return {
        "front": [
            _level(half_x, layout.board_top_mm, -NEXT_MM),
            _tall(half_x, low, top, NEAR_MM),
            _tall(half_x, top, layout.baffle_top_mm, NEAR_MM),
            _tall(half_x, layout.board_top_mm, low, NEAR_MM),
            _level(layout.baffle_radius_mm, layout.baffle_top_mm, NEAR_MM,
                   f"⌀{2 * layout.baffle_radius_mm:g}"),
        ],
        "above": [
            *_screws(layout, half_y, f"⌀{layout.design.fasteners.clearance_hole_mm:g}"),
            _tall(half_x, -half_y, half_y, FAR_MM),
            _level(light.place_mm, -half_y, -NEAR_MM, f"{2 * light.place_mm:g}  (LEDs)"),
            _level(layout.cavity.half_mm[0] - layout.design.printing.clearance_mm, half_y, NEXT_MM,
                   f"{2 * (layout.cavity.half_mm[0] - layout.design.printing.clearance_mm):g}"
                   f"  (tongue, {TONGUE_MM:g} high)"),
        ],
    }  # fmt: skip


def _shell(layout: Layout) -> Views:
    (half_x, half_y), screws = layout.outer.half_mm, layout.design.fasteners
    low = layout.plate_top_mm
    hole = f"⌀{screws.insert_hole_mm:g} × {screws.insert_hole_depth_mm:g}"
    return {
        "front": [
            _level(half_x, low, -NEXT_MM),
            _level(layout.cavity.half_mm[0], low, -NEAR_MM),
            _tall(half_x, low, layout.shell_top_mm, FAR_MM - 4),
            _tall(half_x, layout.window_bottom_mm, layout.shell_top_mm, NEAR_MM),
            _tall(half_x, layout.ledge_bottom_mm, layout.window_bottom_mm, NEAR_MM),
            _level(layout.pocket.half_mm[0], layout.shell_top_mm, NEXT_MM),
            _level(layout.opening.half_mm[0], layout.shell_top_mm, NEAR_MM),
        ],
        "below": [*_screws(layout, half_y, hole), _tall(half_x, -half_y, half_y, FAR_MM)],
    }


def _tray(layout: Layout) -> Views:
    mould, skin = layout.design.mould, layout.design.skin
    half_x, half_y = layout.window.grown(mould.wall_mm).half_mm
    room_x, room_y = layout.window.grown(layout.design.window.clearance_mm).half_mm
    depth = layout.design.window.thickness_mm + skin.gel_mm + skin.cover_mm
    top = mould.floor_mm + depth
    return {
        "front": [
            _level(half_x, 0.0, -NEAR_MM),
            _tall(half_x, 0.0, mould.floor_mm, NEAR_MM),
            _tall(half_x, mould.floor_mm, top, NEAR_MM),
            _tall(half_x, 0.0, top, NEXT_MM),
        ],
        "above": [
            _level(room_x, half_y, NEAR_MM),
            _tall(half_x, -room_y, room_y, NEAR_MM),
            _tall(half_x, -half_y, half_y, NEXT_MM),
            _level(half_x - mould.wall_mm / 2, -half_y, -NEAR_MM, f"2 dowels ⌀{mould.dowel_mm:g}"),
        ],
    }


def _lid(layout: Layout) -> Views:
    mould, plug = layout.design.mould, layout.design.skin.cover_mm
    half_x, half_y = layout.window.grown(mould.wall_mm).half_mm
    plug_x, plug_y = layout.window.grown(-0.1).half_mm
    return {
        "front": [
            _level(half_x, 0.0, -NEAR_MM),
            _tall(half_x, 0.0, mould.lid_mm, NEAR_MM),
            _tall(half_x, mould.lid_mm, mould.lid_mm + plug, NEAR_MM),
        ],
        "above": [
            _level(plug_x, half_y, NEAR_MM),
            _tall(half_x, -plug_y, plug_y, NEAR_MM),
            _tall(half_x, -half_y, half_y, NEXT_MM),
        ],
    }


def _gripper(layout: Layout) -> Views:
    holders, (half_x, half_y) = layout.design.holders, layout.outer.half_mm
    length = max(holders.gripper_length_mm, 2 * half_y)
    low = half_y - length
    hole = holders.gripper_hole_pitch_mm / 2
    return {
        "front": [
            _level(half_x, -holders.plate_mm, -NEAR_MM),
            _tall(half_x, -holders.plate_mm, 0.0, NEAR_MM),
        ],
        "above": [
            *_screws(layout, half_y, f"⌀{layout.design.fasteners.clearance_hole_mm:g}"),
            _tall(half_x, low, half_y, FAR_MM),
            _level(hole, low, -NEAR_MM, f"{2 * hole:g}  (2 × ⌀{holders.gripper_hole_mm:g})"),
            _tall(half_x, low, (low - half_y) / 2, NEAR_MM),
        ],
    }  # fmt: skip


def _flange(layout: Layout) -> Views:
    holders = layout.design.holders
    half, low = holders.flange_mm / 2, -holders.flange_thickness_mm
    bolt = holders.flange_circle_mm / 2 / 2**0.5
    return {
        "front": [
            _level(holders.flange_spigot_mm / 2, low - SPIGOT_HEIGHT_MM, -NEAR_MM,
                   f"⌀{holders.flange_spigot_mm:g}"),
            _level(half, low, -NEXT_MM - 4, f"⌀{2 * half:g}"),
            _tall(half, low, 0.0, NEAR_MM),
            _tall(half, low - SPIGOT_HEIGHT_MM, low, NEAR_MM),
        ],
        "below": [
            _level(bolt, half, NEAR_MM, f"{2 * bolt:.4g}  (4 × ⌀{holders.flange_hole_mm:g} on "
                   f"⌀{holders.flange_circle_mm:g})"),
            _level(layout.screw_places_mm[-1][0], -half, -NEAR_MM,
                   f"{2 * layout.screw_places_mm[-1][0]:.4g}  (sensor)"),
        ],
    }  # fmt: skip


_VIEWS = {
    "base": _base,
    "shading-plate": _plate,
    "shell": _shell,
    "mould-tray": _tray,
    "mould-lid": _lid,
    "holder-2f85": _gripper,
    "holder-iso-flange": _flange,
}
