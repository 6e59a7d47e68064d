"""Checks of the light's ways: skin to sensor, LEDs to skin; and of current and heat."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from spikingtac_hardware.checks.finding import Finding, least, most
from spikingtac_hardware.layout import BAFFLE_WALL_MM, Layout
from spikingtac_hardware.light import light_figures
from spikingtac_hardware.optics import Imaging

LENS_GAP_MM = 1.0
"""Least gap between lens and window, mm (ours: focus travel, and a window that bends)."""
RAY_MARGIN_MM = 0.3
"""Least gap between a ray of use and a printed part, mm (ours: print and focus tolerances)."""
DISC_RADIUS_PX = 4.0
"""Least radius of a disc on the sensor, px: the trackers' discs of 7 px have room to shrink."""
PITCH_RADII = 3.0
"""Least pitch in radii: two neighbours that approach each other by a radius stay apart."""
BLUR_PX = 1.5
"""Largest diameter of the blur disc at the deepest press, px (ours: three times that at rest)."""
MOTION_PX = 10.0
"""Least distance of the outer discs' edges from the sensor's edge, px (ours: a slide of 0.6 mm)."""
SKIN_LUX = 1000.0
"""Least illuminance of the skin, lx: the twin's latency and bandwidth are assumed for 1 klx."""
UNIFORMITY = 0.5
"""Least over largest illuminance of the discs: a factor of two, a fifth of the contrast's log."""
WARMING_K = 15.0
"""Largest warming, K (ours: dark noise doubles every 6 to 10 K, cold skin must not sweat)."""


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
    yield least("lens.circle", f"for a sensor of {math.hypot(*design.sensor.size_mm):.2f} mm "
                "across corners the image circle is", design.lens.image_circle_mm,
                math.hypot(*design.sensor.size_mm))  # fmt: skip
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
