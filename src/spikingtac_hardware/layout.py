"""Where everything stands: heights above the base's underside, and outlines about the axis.

All lengths are mm. z is 0 at the underside of the base and grows towards the skin. Every part,
check and drawing reads the same numbers from here.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

from spikingtac_hardware.design import Design

# Gap about boards that lie in a pocket, mm on each side (a board shop's outline tolerance).
FIT_GAP_MM = 0.1

# Radius of inner upright edges, mm: a printed or laser-cut corner is never sharp.
SMALL_RADIUS_MM = 0.5
POST_MM = 1.2  # Diameter of the posts of the shading plate that hold the camera board, mm.
BAFFLE_WALL_MM = 1.0  # Wall of the rim about the lens, mm.

Place = tuple[float, float]


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
        return self.half_mm[0] if self.kind == "round" else math.hypot(*self.half_mm)

    @property
    def area_mm2(self) -> float:
        """Area, mm²; the rounding of a rectangle's corners is left out."""
        return math.prod(self.size_mm) * (math.pi / 4 if self.kind == "round" else 1.0)


class Layout:
    """Heights and outlines of a design.

    Args:
        design: The parameters.

    Attributes:
        board_bottom_mm: Underside of the camera board.
        board_top_mm: Its upper side.
        holder_top_mm: Upper side of the lens holder.
        lens_front_mm: Front vertex of the lens.
        pupil_mm: Entrance pupil of the lens.
        base_top_mm: Upper side of the base, on which plate and LED board lie.
        plate_top_mm: Upper side of the shading plate, on which the shell stands.
        baffle_top_mm: Upper end of the rim about the lens.
        pillar_top_mm: Upper end of the shell's pillars.
        led_top_mm: Light-giving side of the LEDs.
        ledge_bottom_mm: Lower side of the ledge under the window.
        window_bottom_mm: Lower side of the window.
        window_top_mm: Its upper side.
        disc_mm: Plane of the discs, between gel and cover.
        shell_top_mm: Upper end of the shell.
        outer: Outer faces of the housing.
        window: Window, gel and cover.
        pocket: Pocket of the shell for the window.
        opening: Opening of the ledge under the window.
        cavity: Room of the shell below the ledge.
        led_board: Outer edge of the LED board; the screws' bosses are cut out of it.
        slope_mm: Height of the slope of 45 degrees that leads up to the ledge, mm.
        baffle_radius_mm: Inner radius of the rim about the lens, mm.
        pillar_radius_mm: Radius of the pillars of the shell that hold the inserts, mm.
        boss_radius_mm: Radius of the plate's bosses, on which the screws press, mm.
        screw_places_mm: ``(x, y)`` of the four screws, mm.
        post_places_mm: ``(x, y)`` of the posts that hold the camera board, mm.
        led_opening_half_mm: Half the width of the square opening of the LED board, mm.
        disc_places_mm: ``(x, y)`` of the discs, row by row, mm.
        disc_reach_mm: Distance of the farthest edge of a disc from the axis, mm.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        housing, skin, board, screws = design.housing, design.skin, design.board, design.fasteners
        least_wall_mm = design.printing.least_wall_mm
        self.board_bottom_mm = housing.floor_mm + board.below_mm
        self.board_top_mm = self.board_bottom_mm + board.thickness_mm
        self.holder_top_mm = self.board_top_mm + board.holder_mm[1]
        image_mm = self.board_top_mm + design.sensor.image_plane_mm
        self.lens_front_mm = image_mm + design.lens.track_mm
        self.pupil_mm = self.lens_front_mm - design.lens.pupil_mm
        self.base_top_mm = housing.base_mm
        self.plate_top_mm = housing.base_mm + housing.plate_mm
        self.baffle_top_mm = self.plate_top_mm + housing.baffle_mm
        self.pillar_top_mm = self.plate_top_mm + screws.insert_hole_depth_mm + least_wall_mm
        self.led_top_mm = housing.base_mm + design.light.board_mm + design.light.led_mm[2]
        self.disc_mm = housing.height_mm - skin.cover_mm
        self.window_top_mm = self.disc_mm - skin.gel_mm
        self.window_bottom_mm = self.window_top_mm - design.window.thickness_mm
        self.ledge_bottom_mm = self.window_bottom_mm - housing.ledge_thickness_mm
        self.shell_top_mm = self.window_top_mm + housing.rim_mm
        self._place()

    def _place(self) -> None:
        """Set what lies about the axis: outlines, radii and places."""
        design, housing, skin = self.design, self.design.housing, self.design.skin
        screws, clearance_mm = design.fasteners, design.printing.clearance_mm
        self.outer = Outline(housing.outline, housing.size_mm, housing.corner_radius_mm)
        self.window = Outline(skin.outline, skin.size_mm)
        self.pocket = self.window.grown(design.window.clearance_mm)
        self.opening = self.window.grown(-housing.ledge_mm)
        self.cavity = self.outer.grown(-housing.wall_mm)
        self.led_board = self.cavity.grown(-2 * FIT_GAP_MM)
        self.slope_mm = max(self.cavity.half_mm[0] - self.opening.half_mm[0], 0.0)
        self.baffle_radius_mm = design.lens.barrel_mm / 2 + clearance_mm
        self.pillar_radius_mm = screws.insert_hole_mm / 2 + screws.insert_wall_mm + FIT_GAP_MM
        self.boss_radius_mm = screws.clearance_hole_mm / 2 + design.printing.least_wall_mm

        half_x, half_y = (half - screws.inset_mm for half in self.outer.half_mm)
        if self.outer.kind == "round":
            half_x = half_y = half_x / math.sqrt(2)
        self.screw_places_mm = corners(half_x, half_y)
        post = design.board.holder_mm[0] / 2 + 2 * FIT_GAP_MM + POST_MM / 2
        self.post_places_mm = corners(post, post)
        self.led_opening_half_mm = post + POST_MM / 2 + 2 * FIT_GAP_MM
        rows, columns = (
            [skin.pitch_mm * (index - (count - 1) / 2) for index in range(count)]
            for count in skin.grid
        )
        self.disc_places_mm = tuple((x, y) for y, x in itertools.product(rows, columns))
        self.disc_reach_mm = math.hypot(*self.disc_places_mm[0]) + skin.disc_diameter_mm / 2

    def led_boxes_mm(self, more_mm: float = 0.0) -> list[tuple[Place, tuple[float, float]]]:
        """Return ``(x, y)`` and ``(width, depth)`` of each LED, longer by ``more_mm`` at each end.

        Half of them lie along x, on the two level sides, half along y.
        """
        light = self.design.light
        length, width = (side + 2 * more_mm for side in light.led_mm[:2])
        each = light.leds // 4
        steps = [0.0] if each == 1 else [2 * k / (each - 1) - 1 for k in range(each)]
        # Where the housing is less deep than wide, the left and right sides lie farther out and are
        # shorter, both by the same length.
        more = self.outer.half_mm[0] - self.outer.half_mm[1]
        ways = list(itertools.product((-1, 1), steps))
        level = [(step * light.spread_mm, side * light.place_mm) for side, step in ways]
        upright = [
            (side * (light.place_mm + more), step * (light.spread_mm - more)) for side, step in ways
        ]
        along_x = [(place, (length, width)) for place in level]
        return along_x + [(place, (width, length)) for place in upright]


def corners(half_x: float, half_y: float) -> tuple[Place, ...]:
    """Return the four corners of a rectangle about the axis, mm."""
    return tuple((sx * half_x, sy * half_y) for sy in (-1, 1) for sx in (-1, 1))
