"""Whether a design can be built and works: every check with its figure, its limit and a reason."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac_hardware.design import Design
from spikingtac_hardware.layout import BAFFLE_WALL_MM, FIT_GAP_MM, POST_MM, Layout
from spikingtac_hardware.light import light_figures
from spikingtac_hardware.optics import Imaging

LEDGE_BEARING_MM = 1.0  # Least width on which the window rests, mm (ours: a bead of glue).

# Least engagement of a screw in its insert, in thread diameters (textbook, brass).
ENGAGED_DIAMETERS = 1.5
TIP_ROOM_MM = 0.3  # Least room between a screw's tip and the bottom of its hole, mm (ours).

# Least height by which the gel stands free over the rim, mm (ours: what is touched first).
RIM_BELOW_SKIN_MM = 1.0
HOLDER_WALL_MM = 0.8  # Wall of the lens holder, mm (class).
MARGIN_MM = 0.3  # Least gap between parts that must not touch, mm (ours).

# Least gap to a bought sheet in its pocket, mm on each side (tolerance of laser cutting).
SHEET_GAP_MM = 0.05

# Least gap between lens and window, mm (ours: focus travel, and a window that bends).
LENS_GAP_MM = 1.0

# Least gap between a ray of use and a printed part, mm (ours: print and focus tolerances).
RAY_MARGIN_MM = 0.3

# Least radius of a disc on the sensor, px: the trackers' discs of 7 px have room to shrink.
DISC_RADIUS_PX = 4.0

# Least pitch in radii: two neighbours that approach each other by a radius stay apart.
PITCH_RADII = 3.0

# Largest diameter of the blur disc at the deepest press, px (ours: three times that at rest).
BLUR_PX = 1.5

# Least distance of the outer discs' edges from the sensor's edge, px (ours: a slide of 0.6 mm).
MOTION_PX = 10.0

# Least illuminance of the skin, lx: the twin's latency and bandwidth are assumed for 1 klx.
SKIN_LUX = 1000.0

# Least over largest illuminance of the discs: a factor of two, a fifth of the contrast's log.
UNIFORMITY = 0.5

# Largest warming, K (ours: dark noise doubles every 6 to 10 K, cold skin must not sweat).
WARMING_K = 15.0


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        name: Name of the check, ``part.property``.
        reason: What the value is and what is needed, in one sentence.
        value: What was found.
        needed: The limit.
        unit: Unit of both.
        at_least: True where ``needed`` is the least value, False where it is the largest.
    """

    name: str
    reason: str
    value: float
    needed: float
    unit: str
    at_least: bool = True

    @property
    def passed(self) -> bool:
        """True where the value is within its limit, up to a rounding error of one billionth."""
        excess = self.value - self.needed
        return (excess if self.at_least else -excess) >= -1e-9


def least(name: str, what: str, value: float, needed: float, unit: str = "mm") -> Finding:
    """Return a finding on a value that must not be smaller than a limit.

    Args:
        name: Name of the check.
        what: The sentence up to the value, as in ``"the window leaves"``.
        value: What was found.
        needed: The limit.
        unit: Unit of both.
    """
    reason = f"{what} {_shown(value)} {unit}".rstrip() + f"; needed {_shown(needed)}"
    return Finding(name, reason, float(value), float(needed), unit)


def most(name: str, what: str, value: float, allowed: float, unit: str = "mm") -> Finding:
    """Return a finding on a value that must not be larger than a limit; see :func:`least`."""
    reason = f"{what} {_shown(value)} {unit}".rstrip() + f"; allowed {_shown(allowed)}"
    return Finding(name, reason, float(value), float(allowed), unit, at_least=False)


def _shown(value: float) -> str:
    text = f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def check_design(design: Design) -> tuple[Finding, ...]:
    """Return the findings of every check.

    Where the lens would reach into the window nothing can be said of the optics; these checks are
    then left out, since the gap's own finding fails.

    Example:
        >>> from spikingtac_hardware.design import load_design
        >>> all(finding.passed for finding in check_design(load_design()))
        True
    """
    layout = Layout(design)
    gap = lens_gap(layout)
    optical = optical_findings(layout) if gap.value > 0 else ()
    return (gap, *mechanical_findings(layout), *optical)


def require_sound(design: Design) -> tuple[Finding, ...]:
    """Return the findings of a design that passes every check.

    Raises:
        ConfigError: A check fails; gives the reason of each that does.
    """
    findings = check_design(design)
    failed = [finding for finding in findings if not finding.passed]
    if failed:
        reasons = "\n".join(f"  {finding.name}: {finding.reason}" for finding in failed)
        raise ConfigError(f"{len(failed)} of {len(findings)} checks of the design fail:\n{reasons}")
    return findings


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
    screws = layout.design.fasteners
    yield least("screw.head", f"a counterbore of {screws.counterbore_mm:g} mm hides the head by",
                screws.counterbore_mm - screws.head_mm[1], 0.0)  # fmt: skip
    plain = layout.plate_top_mm - screws.counterbore_mm
    length = screws.length_mm
    nearest = min(screws.lengths_mm, key=lambda listed: abs(listed - length))
    text = f"a screw of {length:g} mm is away from the listed {nearest:g} mm by"
    yield most("screw.length", text, abs(nearest - length), 0.0)
    inside = min(length - plain, screws.insert_length_mm)
    yield least("screw.engagement", f"a screw of {length:g} mm engages its insert by",
                inside, ENGAGED_DIAMETERS * screws.thread_mm)  # fmt: skip
    room = screws.insert_hole_depth_mm - (length - plain)
    yield least("screw.tip", f"a screw of {length:g} mm leaves to the bottom of its hole",
                room, TIP_ROOM_MM)  # fmt: skip
    yield least("insert.hole", "the hole for an insert is deeper than the insert by",
                screws.insert_hole_depth_mm - screws.insert_length_mm, TIP_ROOM_MM)  # fmt: skip


def lens_gap(layout: Layout) -> Finding:
    """Return the finding on the room between lens and window."""
    gap = layout.window_bottom_mm - layout.lens_front_mm
    found = f"{gap:.1f}" if abs(gap - LENS_GAP_MM) > 0.1 else f"{gap:.3f}"
    text = f"the gel of {layout.design.skin.gel_mm:g} mm leaves {found} mm to the lens"
    return Finding("lens.gap", f"{text}; needed {LENS_GAP_MM:.1f}", gap, LENS_GAP_MM, "mm")


def optical_findings(layout: Layout) -> Iterator[Finding]:
    """Yield the findings on image, rays, light, current and heat.

    The lens must not reach into the window; see :func:`lens_gap`.
    """
    imaging = Imaging(layout)
    yield from _image(layout, imaging)
    yield from _rays(layout, imaging)
    yield from _light(layout, imaging)


def _image(layout: Layout, imaging: Imaging) -> Iterator[Finding]:
    design, skin = layout.design, layout.design.skin
    for axis, seen, wanted in zip("xy", imaging.field_mm, skin.size_mm, strict=True):
        yield least(f"field.{axis}", f"at {imaging.px_per_mm:.2f} px/mm the sensor sees of the "
                    f"skin along {axis}", seen, wanted)  # fmt: skip
    yield most("lens.angle", "the farthest ray leaves the lens's axis by",
               imaging.corner_angle_deg, design.lens.half_angle_deg, "degrees")  # fmt: skip
    yield least("lens.circle", f"for a sensor of {math.hypot(*design.sensor_mm):.2f} mm "
                "across corners the image circle is", design.lens.image_circle_mm,
                math.hypot(*design.sensor_mm))  # fmt: skip
    yield most("lens.blur", f"a press of {skin.deepest_press_mm:g} mm makes a blur disc of",
               imaging.blur_px(skin.deepest_press_mm), BLUR_PX, "px")  # fmt: skip
    radius_px = skin.disc_diameter_mm / 2 * imaging.px_per_mm
    yield least("disc.radius", f"a disc of {skin.disc_diameter_mm:g} mm has on the sensor a "
                "radius of", radius_px, DISC_RADIUS_PX, "px")  # fmt: skip
    yield least("disc.pitch", "the pitch in radii of a disc is",
                2 * skin.pitch_mm / skin.disc_diameter_mm, PITCH_RADII, "")  # fmt: skip
    yield least("disc.margin", "the outer discs stay inside the sensor's edge by",
                _disc_margin_px(layout, imaging), MOTION_PX, "px")  # fmt: skip
    inside = _skin_margin_mm(layout)
    yield least("disc.inside", "the outer discs stay inside the skin's edge by",
                inside, RAY_MARGIN_MM)  # fmt: skip


def _disc_margin_px(layout: Layout, imaging: Imaging) -> float:
    radius_px = layout.design.skin.disc_diameter_mm / 2 * imaging.px_per_mm
    places = np.array(layout.disc_places_mm)
    distance_mm = np.maximum(np.hypot(*places.T), 1e-9)
    image_px = np.abs(places) * (imaging.image_px(distance_mm) / distance_mm)[:, None]
    return float((np.array(layout.design.sensor.pixels) / 2 - image_px).min() - radius_px)


def _skin_margin_mm(layout: Layout) -> float:
    if layout.window.kind == "round":
        return layout.window.half_mm[0] - layout.disc_reach_mm
    x, y = (abs(place) for place in layout.disc_places_mm[0])
    half_x, half_y = layout.window.half_mm
    return min(half_x - x, half_y - y) - layout.design.skin.disc_diameter_mm / 2


def _rays(layout: Layout, imaging: Imaging) -> Iterator[Finding]:
    half = layout.window.half_mm
    edge_x, edge_y, corner = (
        float(imaging.tangent(np.array([reach]))[0]) for reach in (*half, layout.window.reach_mm)
    )
    aperture_mm = layout.design.lens.focal_mm / layout.design.lens.f_number / 2
    for axis, tangent, opening in zip("xy", (edge_x, edge_y), layout.opening.half_mm, strict=True):
        at_ledge = tangent * (layout.window_bottom_mm - layout.pupil_mm) + aperture_mm
        yield least(f"rays.ledge.{axis}", f"rays to the skin's edge along {axis} pass the ledge "
                    "at a distance of", opening - at_ledge, RAY_MARGIN_MM)  # fmt: skip
    rise = max(layout.baffle_top_mm - layout.pupil_mm, 0.0)
    yield least("rays.baffle", "rays to the skin's corner pass the rim about the lens at",
                layout.baffle_radius_mm - corner * rise - aperture_mm, RAY_MARGIN_MM)  # fmt: skip
    pillar_top = layout.plate_top_mm + layout.design.fasteners.insert_hole_depth_mm
    pillar_top += layout.design.printing.least_wall_mm
    place = math.hypot(*layout.screw_places_mm[-1]) - layout.pillar_radius_mm
    at_pillar = corner * max(pillar_top - layout.pupil_mm, 0.0) + aperture_mm
    yield least("rays.pillars", "rays to the skin's corner pass the pillars at",
                place - at_pillar, RAY_MARGIN_MM)  # fmt: skip


def _light(layout: Layout, imaging: Imaging) -> Iterator[Finding]:
    light, figures = layout.design.light, light_figures(layout, imaging)
    yield most("leds.current", "each LED carries", light.current_ma, light.rated_ma, "mA")
    yield least("leds.supply", f"a supply of {light.supply_v:g} V leaves the driver",
                light.supply_v - light.forward_v, 0.5, "V")  # fmt: skip
    yield least("light.skin", "in the middle of the skin there are", figures.centre_lux,
                SKIN_LUX, "lx")  # fmt: skip
    yield least("light.uniformity", "the darkest disc has of the brightest one's light",
                figures.uniformity, UNIFORMITY, "")  # fmt: skip
    yield least("light.baffle", "the rim about the lens stands over the line from an LED to the "
                "lens by", _shadow_mm(layout), 0.0)  # fmt: skip
    yield most("heat", f"{figures.power_mw:.0f} mW warm the sensor by", figures.warming_k,
               WARMING_K, "K")  # fmt: skip


def _shadow_mm(layout: Layout) -> float:
    """Return by how much the rim stands over the line from the nearest LED to the lens, mm."""
    light, lens = layout.design.light, layout.design.lens
    source = light.place_mm - light.led_mm[1] / 2
    rim = layout.baffle_radius_mm + BAFFLE_WALL_MM
    seen = lens.barrel_mm / 4  # half the barrel's radius: the front glass
    share = (source - rim) / (source + seen)
    line = layout.led_top_mm + share * (layout.lens_front_mm - layout.led_top_mm)
    return layout.baffle_top_mm - line
