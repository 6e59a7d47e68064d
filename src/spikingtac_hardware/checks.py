"""Whether a design can be built and works: every check with its figure, its limit and a reason."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac_hardware.design import Design
from spikingtac_hardware.layout import BAFFLE_WALL_MM, FIT_GAP_MM, POST_MM, Layout
from spikingtac_hardware.optics import Imaging, light_figures

LEDGE_BEARING_MM = 1.0  # Least width on which the window rests, mm: a bead of glue.

# Least engagement of a screw in its insert, in thread diameters (textbook, brass).
ENGAGED_DIAMETERS = 1.5
TIP_ROOM_MM = 0.3  # Least room between a screw's tip and the bottom of its hole, mm.

# Least height by which the gel stands free over the rim, mm: it is what is touched first.
RIM_BELOW_SKIN_MM = 1.0
HOLDER_WALL_MM = 0.8  # Wall of the lens holder, mm (typical of board lenses).
MARGIN_MM = 0.3  # Least gap between parts that must not touch, mm.

# Least gap to a bought sheet in its pocket, mm on each side (tolerance of laser cutting).
SHEET_GAP_MM = 0.05

# Least gap between lens and window, mm: focus travel, and a window that bends.
LENS_GAP_MM = 1.0

# Least gap between a ray of use and a printed part, mm: print and focus tolerances.
RAY_MARGIN_MM = 0.3

# Least radius of a disc on the sensor, px: the trackers' discs of 7 px have room to shrink.
DISC_RADIUS_PX = 4.0

# Least pitch in radii: two neighbours that approach each other by a radius stay apart.
PITCH_RADII = 3.0

# Largest diameter of the blur disc at the deepest press, px: three times that at rest.
BLUR_PX = 1.5

# Least distance of the outer discs' edges from the sensor's edge, px: a slide of 0.6 mm.
MOTION_PX = 10.0

# Least illuminance of the skin, lx: the twin's latency and bandwidth are assumed for 1 klx.
SKIN_LUX = 1000.0

# Least over largest illuminance of the discs: a factor of two, a fifth of the contrast's log.
UNIFORMITY = 0.5

# Largest warming, K: dark noise doubles every 6 to 10 K, cold skin must not sweat.
WARMING_K = 15.0
DRIVER_V = 0.5  # Least voltage that the supply leaves to the LEDs' driver, V.

# Checks whose limit is the largest value; that of the others is the least.
MOST = ("screw.length", "lens.angle", "lens.blur", "leds.current", "heat")

# A check: its name, the sentence up to the value, the value, the limit, and a unit but for mm.
Check = tuple[str, str, float, float] | tuple[str, str, float, float, str]


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


def _finding(check: Check) -> Finding:
    name, what, value, limit, unit = check if len(check) == 5 else (*check, "mm")
    limited = "allowed" if name in MOST else "needed"
    reason = f"{what} {_shown(value)} {unit}".rstrip() + f"; {limited} {_shown(limit)}"
    return Finding(name, reason, float(value), float(limit), unit, name not in MOST)


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
    gap = layout.window_bottom_mm - layout.lens_front_mm
    found = f"{gap:.1f}" if abs(gap - LENS_GAP_MM) > 0.1 else f"{gap:.3f}"
    reason = f"the gel of {design.skin.gel_mm:g} mm leaves {found} mm to the lens"
    reason += f"; needed {LENS_GAP_MM:.1f}"
    checks = [*_housing(layout), *_boards(layout), *_screws(layout)]
    if gap > 0:
        imaging = Imaging(layout)
        checks += [*_image(layout, imaging), *_rays(layout, imaging), *_light(layout, imaging)]
    lens_gap = Finding("lens.gap", reason, gap, LENS_GAP_MM, "mm")
    return (lens_gap, *(_finding(check) for check in checks))


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


def _housing(layout: Layout) -> Iterator[Check]:
    """Yield the checks of walls, window and pillars."""
    design, thinnest = layout.design, layout.design.printing.least_wall_mm
    housing, screws = design.housing, design.fasteners
    rim = min(o - p for o, p in zip(layout.outer.half_mm, layout.pocket.half_mm, strict=True))
    skin, size = f"a skin of {design.skin.size_mm[0]:g} mm", f"{housing.size_mm[0]:g} mm"
    yield "shell.rim", f"{skin} in a housing of {size} leaves a rim of", rim, thinnest
    yield "shell.wall", "the shell's wall is", housing.wall_mm, thinnest
    yield "base.floor", "the base's floor is", housing.floor_mm, thinnest
    roof = housing.plate_mm - design.light.board_mm - FIT_GAP_MM
    yield "plate.roof", "over the LED board the shading plate keeps", roof, thinnest
    head = (screws.head_mm[0] + screws.head_clearance_mm) / 2
    outside, inside = screws.inset_mm - head, _to_cavity_mm(layout) - head
    text = "between a screw's head and {} the base keeps"
    yield "base.counterbore", text.format("the outer face"), outside, thinnest
    yield "base.cavity", text.format("the board's space"), inside, thinnest
    outside = screws.inset_mm - screws.insert_hole_mm / 2
    yield "shell.insert", "outside of an insert the shell keeps", outside, screws.insert_wall_mm
    gap = design.window.clearance_mm
    yield "window.clearance", "the window's gap to the shell is", gap, SHEET_GAP_MM
    yield "window.ledge", "the window rests on a ledge of", housing.ledge_mm, LEDGE_BEARING_MM
    free = layout.disc_mm + design.skin.cover_mm - layout.shell_top_mm
    yield "skin.free", "over the rim of the window the skin stands out by", free, RIM_BELOW_SKIN_MM
    above = layout.ledge_bottom_mm - layout.slope_mm - layout.plate_top_mm
    pillar = layout.pillar_top_mm - layout.plate_top_mm
    yield "shell.height", "between plate and ledge the shell's pillars have", above, pillar


def _to_cavity_mm(layout: Layout) -> float:
    """Return the distance from a screw's axis to the space of the camera board, mm."""
    board, (x, y) = layout.design.board, layout.screw_places_mm[-1]
    half_x, half_y = (size / 2 + FIT_GAP_MM for size in board.size_mm)
    slanted = (x + y - half_x - half_y + board.chamfer_mm) / math.sqrt(2)
    return max(slanted, x - half_x, y - half_y)


def _boards(layout: Layout) -> Iterator[Check]:
    """Yield the checks of camera board, lens holder and LEDs."""
    design, board = layout.design, layout.design.board
    width, depth = board.size_mm
    around = min(o - b / 2 for o, b in zip(layout.outer.half_mm, board.size_mm, strict=True))
    if layout.outer.kind == "round":
        around = layout.outer.half_mm[0] - math.hypot(width / 2, depth / 2 - board.chamfer_mm)
    thinnest = design.printing.least_wall_mm
    text = "beside the camera board the base has a wall of"
    yield "board.wall", text, around - FIT_GAP_MM, thinnest
    cable_mm = design.housing.cable_mm[1]
    yield "board.cable", "the slot for the cable has below the board", board.below_mm, cable_mm
    under = layout.base_top_mm - layout.holder_top_mm
    yield "holder.height", "under the shading plate the lens holder has", under, FIT_GAP_MM
    beside = (board.holder_mm[0] - max(design.sensor.package_mm[:2])) / 2 - HOLDER_WALL_MM
    yield "holder.width", "about the package the lens holder's room has on each side", beside, 0.0
    # From a post to the straight or the cut edge of the board.
    post = layout.post_places_mm[-1][0]
    slanted = ((width + depth) / 2 - board.chamfer_mm - 2 * post) / math.sqrt(2)
    edge = min(min(width, depth) / 2 - post, slanted) - POST_MM / 2
    yield "board.posts", "outside of the posts of the plate the camera board has", edge, 0.0
    yield from _leds(layout)


def _leds(layout: Layout) -> Iterator[Check]:
    light, board = layout.design.light, layout.led_board
    places, halves = (np.array(part) for part in zip(*layout.led_boxes_mm(), strict=True))
    halves /= 2
    inside = light.place_mm - light.led_mm[1] / 2 - layout.led_opening_half_mm
    yield "leds.inside", "between the opening of their board and the LEDs are", inside, MARGIN_MM
    far = np.abs(places) + halves
    room = board.half_mm[0] - np.hypot(*far.T) if board.kind == "round" else board.half_mm - far
    yield "leds.outside", "between the LEDs and the edge of their board are", room.min(), MARGIN_MM
    bosses = np.abs(np.array(layout.screw_places_mm)[:, None] - places) - halves
    gap = np.hypot(*np.maximum(bosses, 0.0).T).min() - layout.boss_radius_mm - MARGIN_MM
    yield "leds.screws", "between an LED's window and a screw's boss the plate keeps", gap, 0.0
    one, other = np.triu_indices(len(places), 1)
    apart = np.abs(places[one] - places[other]) - halves[one] - halves[other] - 2 * MARGIN_MM
    web, thinnest = np.hypot(*np.maximum(apart, 0.0).T).min(), layout.design.printing.least_wall_mm
    yield "leds.web", "between the windows of two LEDs the plate keeps", web, thinnest
    below = layout.plate_top_mm - layout.led_top_mm
    yield "leds.below", "the shading plate's upper side is above the LEDs by", below, MARGIN_MM


def _screws(layout: Layout) -> Iterator[Check]:
    screws = layout.design.fasteners
    length, hole = screws.length_mm, screws.insert_hole_depth_mm
    hidden = screws.counterbore_mm - screws.head_mm[1]
    yield "screw.head", "the counterbore hides the head by", hidden, 0.0
    nearest = min(screws.lengths_mm, key=lambda listed: abs(listed - length))
    text = f"the screw differs from the listed {nearest:g} mm by"
    yield "screw.length", text, abs(nearest - length), 0.0
    beyond = length - layout.plate_top_mm + screws.counterbore_mm
    inside, wanted = min(beyond, screws.insert_length_mm), ENGAGED_DIAMETERS * screws.thread_mm
    yield "screw.engagement", f"a screw of {length:g} mm engages its insert by", inside, wanted
    yield "screw.tip", "the screw leaves to the bottom of its hole", hole - beyond, TIP_ROOM_MM
    deeper = hole - screws.insert_length_mm
    yield "insert.hole", "the hole for an insert is deeper than the insert by", deeper, TIP_ROOM_MM


def _image(layout: Layout, imaging: Imaging) -> Iterator[Check]:
    design, skin, lens = layout.design, layout.design.skin, layout.design.lens
    scale = imaging.px_per_mm
    for axis, seen, wanted in zip("xy", imaging.field_mm, skin.size_mm, strict=True):
        yield f"field.{axis}", f"the sensor sees of the skin along {axis}", seen, wanted
    angle = imaging.corner_angle_deg
    yield "lens.angle", "the farthest ray leaves the axis by", angle, lens.half_angle_deg, "degrees"
    across = math.hypot(
        *(count * design.sensor.pixel_um / 1000.0 for count in design.sensor.pixels)
    )
    text = "across the sensor's corners the image circle is"
    yield "lens.circle", text, lens.image_circle_mm, across
    press = skin.deepest_press_mm
    yield "lens.blur", "the deepest press blurs a point to", imaging.blur_px(press), BLUR_PX, "px"
    diameter = skin.disc_diameter_mm
    text = "on the sensor a disc has a radius of"
    yield "disc.radius", text, diameter / 2 * scale, DISC_RADIUS_PX, "px"
    radii = 2 * skin.pitch_mm / diameter
    yield "disc.pitch", "the pitch in radii of a disc is", radii, PITCH_RADII, ""
    places = np.array(layout.disc_places_mm)
    distance_mm = np.maximum(np.hypot(*places.T), 1e-9)
    image_px = np.abs(places) * (imaging.image_px(distance_mm) / distance_mm)[:, None]
    margin_px = (np.array(design.sensor.pixels) / 2 - image_px).min() - diameter / 2 * scale
    yield "disc.margin", "the outer discs keep from the sensor's edge", margin_px, MOTION_PX, "px"
    inside = layout.window.half_mm[0] - layout.disc_reach_mm
    if layout.window.kind != "round":
        inside = (layout.window.half_mm - np.abs(places)).min() - diameter / 2
    yield "disc.inside", "the outer discs keep from the skin's edge", inside, RAY_MARGIN_MM


def _rays(layout: Layout, imaging: Imaging) -> Iterator[Check]:
    reaches_mm = np.array([*layout.window.half_mm, layout.window.reach_mm])
    *edges, corner = imaging.tangent(reaches_mm)
    aperture_mm = layout.design.lens.focal_mm / layout.design.lens.f_number / 2
    for axis, tangent, opening in zip("xy", edges, layout.opening.half_mm, strict=True):
        at_ledge = tangent * (layout.window_bottom_mm - layout.pupil_mm) + aperture_mm
        text = f"rays to the edge along {axis} pass the ledge at"
        yield f"rays.ledge.{axis}", text, opening - at_ledge, RAY_MARGIN_MM
    rise = max(layout.baffle_top_mm - layout.pupil_mm, 0.0)
    room = layout.baffle_radius_mm - corner * rise - aperture_mm
    yield "rays.baffle", "rays to the corner pass the lens's rim at", room, RAY_MARGIN_MM
    place = math.hypot(*layout.screw_places_mm[-1]) - layout.pillar_radius_mm
    at_pillar = corner * max(layout.pillar_top_mm - layout.pupil_mm, 0.0) + aperture_mm
    yield "rays.pillars", "rays to the corner pass the pillars at", place - at_pillar, RAY_MARGIN_MM


def _light(layout: Layout, imaging: Imaging) -> Iterator[Check]:
    light, figures = layout.design.light, light_figures(layout, imaging)
    yield "leds.current", "each LED carries", light.current_ma, light.rated_ma, "mA"
    left = light.supply_v - light.forward_v
    yield "leds.supply", "the supply leaves the driver", left, DRIVER_V, "V"
    yield "light.skin", "the middle of the skin gets", figures["centre_lux"], SKIN_LUX, "lx"
    yield "light.uniformity", "darkest over brightest disc:", figures["uniformity"], UNIFORMITY, ""
    text = "the lens's rim stands over the light of the LEDs by"
    yield "light.baffle", text, _shadow_mm(layout), 0.0
    text = f"{figures['power_mw']:.0f} mW warm the sensor by"
    yield "heat", text, figures["warming_k"], WARMING_K, "K"


def _shadow_mm(layout: Layout) -> float:
    """Return by how much the rim stands over the line from the nearest LED to the lens, mm."""
    light, lens = layout.design.light, layout.design.lens
    source = light.place_mm - light.led_mm[1] / 2
    rim = layout.baffle_radius_mm + BAFFLE_WALL_MM
    seen = lens.barrel_mm / 4  # half the barrel's radius: the front glass
    share = (source - rim) / (source + seen)
    line = layout.led_top_mm + share * (layout.lens_front_mm - layout.led_top_mm)
    return layout.baffle_top_mm - line
