"""Where everything stands: heights above the base's underside, and outlines about the axis.

All lengths are mm. z is 0 at the underside of the base and grows towards the skin. Every part,
check and drawing reads the same numbers from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from spikingtac_hardware.design import Design

# Gap about boards that lie in a pocket, mm on each side (a board shop's outline tolerance).
FIT_GAP_MM = 0.1

# Radius of inner upright edges, mm: a printed or laser-cut corner is never sharp.
SMALL_RADIUS_MM = 0.5
POST_MM = 1.2  # Diameter of the posts of the shading plate that hold the camera board, mm (ours).
BAFFLE_WALL_MM = 1.0  # Wall of the rim about the lens, mm (ours).


@dataclass(frozen=True, slots=True)
class Outline:
    """A rectangle or a circle about the axis.

    Attributes:
        kind: ``rectangle`` or ``round``.
        size_mm: ``(width, depth)``, mm; a circle has its diameter twice.
        radius_mm: Radius of a rectangle's corners, mm.
    """

    kind: Literal["rectangle", "round"]
    size_mm: tuple[float, float]
    radius_mm: float = SMALL_RADIUS_MM

    def grown(self, by_mm: float) -> Outline:
        """Return the outline with ``by_mm`` more on each side; a negative value shrinks it."""
        width, depth = self.size_mm
        radius = max(self.radius_mm + by_mm, SMALL_RADIUS_MM)
        return Outline(self.kind, (width + 2 * by_mm, depth + 2 * by_mm), radius)

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half of the width and of the depth, mm."""
        return self.size_mm[0] / 2, self.size_mm[1] / 2

    @property
    def reach_mm(self) -> float:
        """Distance of the farthest point from the axis, mm."""
        half_x, half_y = self.half_mm
        return half_x if self.kind == "round" else math.hypot(half_x, half_y)

    @property
    def area_mm2(self) -> float:
        """Area, mm²; the rounding of a rectangle's corners is left out."""
        width, depth = self.size_mm
        return math.pi / 4 * width * depth if self.kind == "round" else width * depth


class Layout:
    """Heights and outlines of a design.

    Args:
        design: The parameters.

    Attributes:
        board_bottom_mm: Underside of the camera board.
        board_top_mm: Its upper side.
        image_mm: Pixels.
        lens_front_mm: Front vertex of the lens.
        pupil_mm: Entrance pupil of the lens.
        base_top_mm: Upper side of the base, on which plate and LED board lie.
        plate_top_mm: Upper side of the shading plate, on which the shell stands.
        led_top_mm: Light-giving side of the LEDs.
        window_bottom_mm: Lower side of the window.
        window_top_mm: Its upper side.
        disc_mm: Plane of the discs, between gel and cover.
        shell_top_mm: Upper end of the shell.
    """

    def __init__(self, design: Design) -> None:
        housing, self.design = design.housing, design
        self.board_bottom_mm = housing.floor_mm + design.board.below_mm
        self.board_top_mm = self.board_bottom_mm + design.board.thickness_mm
        self.image_mm = self.board_top_mm + design.sensor.image_plane_mm
        self.lens_front_mm = self.image_mm + design.lens.track_mm
        self.pupil_mm = self.lens_front_mm - design.lens.pupil_mm
        self.base_top_mm = housing.base_mm
        self.plate_top_mm = housing.base_mm + housing.plate_mm
        self.led_top_mm = housing.base_mm + design.light.board_mm + design.light.led_mm[2]
        self.disc_mm = housing.height_mm - design.skin.cover_mm
        self.window_top_mm = self.disc_mm - design.skin.gel_mm
        self.window_bottom_mm = self.window_top_mm - design.window.thickness_mm
        self.shell_top_mm = self.window_top_mm + housing.rim_mm

    @property
    def outer(self) -> Outline:
        """Outer faces of the housing."""
        housing = self.design.housing
        return Outline(housing.outline, housing.size_mm, housing.corner_radius_mm)

    @property
    def window(self) -> Outline:
        """Window, gel and cover."""
        return Outline(self.design.skin.outline, self.design.skin.size_mm)

    @property
    def pocket(self) -> Outline:
        """Pocket of the shell for the window."""
        return self.window.grown(self.design.window.clearance_mm)

    @property
    def opening(self) -> Outline:
        """Opening of the ledge under the window."""
        return self.window.grown(-self.design.housing.ledge_mm)

    @property
    def cavity(self) -> Outline:
        """Room of the shell below the ledge."""
        return self.outer.grown(-self.design.housing.wall_mm)

    @property
    def led_board(self) -> Outline:
        """Outer edge of the LED board; the screws' bosses are cut out of it."""
        return self.cavity.grown(-2 * FIT_GAP_MM)

    @property
    def led_opening_half_mm(self) -> float:
        """Half the width of the square opening of the LED board, mm."""
        return self.post_places_mm[-1][0] + POST_MM / 2 + 2 * FIT_GAP_MM

    @property
    def ledge_bottom_mm(self) -> float:
        """Lower side of the ledge; a slope of 45 degrees leads up to it."""
        return self.window_bottom_mm - self.design.housing.ledge_thickness_mm

    @property
    def slope_mm(self) -> float:
        """Height of that slope, mm."""
        return max(self.cavity.half_mm[0] - self.opening.half_mm[0], 0.0)

    @property
    def baffle_top_mm(self) -> float:
        """Upper end of the rim about the lens."""
        return self.plate_top_mm + self.design.housing.baffle_mm

    @property
    def baffle_radius_mm(self) -> float:
        """Inner radius of the rim about the lens, mm."""
        return self.design.lens.barrel_mm / 2 + self.design.printing.clearance_mm

    @property
    def holder_top_mm(self) -> float:
        """Upper side of the lens holder."""
        return self.board_top_mm + self.design.board.holder_mm[1]

    @property
    def screw_places_mm(self) -> tuple[tuple[float, float], ...]:
        """``(x, y)`` of the four screws, mm."""
        half_x, half_y = self.outer.half_mm
        inset = self.design.fasteners.inset_mm
        if self.outer.kind == "round":
            half_x = half_y = (half_x - inset) / math.sqrt(2) + inset
        return tuple(
            (sx * (half_x - inset), sy * (half_y - inset)) for sy in (-1, 1) for sx in (-1, 1)
        )

    @property
    def pillar_radius_mm(self) -> float:
        """Radius of the pillars of the shell that hold the inserts, mm."""
        fasteners = self.design.fasteners
        return fasteners.insert_hole_mm / 2 + fasteners.insert_wall_mm + FIT_GAP_MM

    @property
    def post_places_mm(self) -> tuple[tuple[float, float], ...]:
        """``(x, y)`` of the posts that hold the camera board, beside the lens holder, mm."""
        place = self.design.board.holder_mm[0] / 2 + 2 * FIT_GAP_MM + POST_MM / 2
        return tuple((sx * place, sy * place) for sy in (-1, 1) for sx in (-1, 1))

    @property
    def led_places_mm(self) -> tuple[tuple[float, float, bool], ...]:
        """``(x, y, lies along x)`` of each LED, mm."""
        light = self.design.light
        each = light.leds // 4
        steps = [0.0] if each == 1 else [2 * k / (each - 1) - 1 for k in range(each)]
        # Where the housing is less deep than wide, the left and right sides lie farther out and are
        # shorter, both by the same length.
        more = self.outer.half_mm[0] - self.outer.half_mm[1]
        level = [(step * light.spread_mm, s * light.place_mm, True) for s in (-1, 1)
                 for step in steps]  # fmt: skip
        upright = [(s * (light.place_mm + more), step * (light.spread_mm - more), False)
                   for s in (-1, 1) for step in steps]  # fmt: skip
        return tuple(level + upright)

    @property
    def disc_places_mm(self) -> tuple[tuple[float, float], ...]:
        """``(x, y)`` of the discs, row by row, mm."""
        rows, columns = self.design.skin.grid
        pitch = self.design.skin.pitch_mm
        return tuple(
            (pitch * (column - (columns - 1) / 2), pitch * (row - (rows - 1) / 2))
            for row in range(rows)
            for column in range(columns)
        )

    @property
    def disc_reach_mm(self) -> float:
        """Distance of the farthest edge of a disc from the axis, mm."""
        x, y = self.disc_places_mm[0]
        return math.hypot(x, y) + self.design.skin.disc_diameter_mm / 2
