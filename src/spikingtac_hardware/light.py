"""Light on the skin, light on the sensor, current and heat.

An LED is a Lambertian source that looks at the skin; the pillars of the shell cast shadows. Window
and gel are taken as air of their reduced thickness. Light that walls and skin send back is left
out, so that the real skin is brighter.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.optics import Imaging

MM2_PER_M2 = 1e6
DARK_LUX = 1e-6  # Illuminance that stands for none where one is divided by it, lx.
LENS_TRANSMISSION = 0.9  # Share of the light that a coated lens lets through (class).

# Heat transfer to still air by convection and radiation, W/(m² K) (textbook: 5 to 15).
FILM_W_M2_K = 10.0

# Share of the LEDs' electrical power that stays as heat (class: the rest is light).
SHARE_OF_LED_HEAT = 0.75


def illuminance_lux(layout: Layout, imaging: Imaging, places_mm: FloatArray) -> FloatArray:
    """Return the illuminance ``(n,)`` of the skin at ``(n, 2)`` places (mm), lx."""
    design = layout.design
    light, index = design.light, design.window.index
    passed = 1 - ((index - 1) / (index + 1)) ** 2  # Fresnel, straight on, at the window
    candela = light.intensity_mcd / 1000.0 * light.current_ma / light.rated_ma
    height_mm = imaging.reduced_mm - imaging.air_mm + layout.window_bottom_mm - layout.led_top_mm
    sources_mm = np.array([place for place, _ in layout.led_boxes_mm()])
    apart_mm2 = ((places_mm[:, None] - sources_mm) ** 2).sum(axis=2) + height_mm**2
    apart_mm2 = np.where(_shaded(layout, sources_mm, places_mm), np.inf, apart_mm2)
    per_mm2 = candela * passed * height_mm**2 / apart_mm2**2
    return per_mm2.sum(axis=1) * MM2_PER_M2


def _shaded(layout: Layout, sources_mm: FloatArray, places_mm: FloatArray) -> NDArray[np.bool_]:
    """Return ``(n, s)``: whether a pillar stands between an LED and a place on the skin."""
    rise = (layout.pillar_top_mm - layout.led_top_mm) / (layout.disc_mm - layout.led_top_mm)
    shaded = np.zeros((len(places_mm), len(sources_mm)), bool)
    way_mm = rise * (places_mm[:, None] - sources_mm)  # to where the ray passes the pillars' top
    for pillar_mm in np.array(layout.screw_places_mm):
        toward_mm = pillar_mm - sources_mm
        along = (way_mm * toward_mm).sum(axis=2) / np.maximum((way_mm**2).sum(axis=2), 1e-12)
        nearest_mm = toward_mm - np.clip(along, 0.0, 1.0)[:, :, None] * way_mm
        shaded |= np.linalg.norm(nearest_mm, axis=2) < layout.pillar_radius_mm
    return shaded


def light_figures(layout: Layout, imaging: Imaging) -> dict[str, float]:
    """Return what the LEDs of a design do.

    Returns:
        ``centre_lux``, illuminance of the middle of the skin; ``uniformity``, least over largest
        illuminance of the discs; ``sensor_lux``, illuminance of the sensor under a bright spot in
        the middle; ``vignetting``, fraction of the light lost at half a sensor width from the
        centre, as the twin counts it, lens and LEDs together; ``supply_ma``, current of the LEDs
        from their supply; ``power_mw`` of LEDs, driver and sensor; ``warming_k`` over still air.
    """
    design = layout.design
    lens, light = design.lens, design.light
    on_discs = illuminance_lux(layout, imaging, np.array(layout.disc_places_mm))
    centre = illuminance_lux(layout, imaging, np.zeros((1, 2)))[0]
    geometry = 4 * lens.f_number**2 * (1 + imaging.magnification) ** 2
    led_mw = light.leds * light.current_ma * light.supply_v
    return {
        "centre_lux": float(centre),
        "uniformity": float(on_discs.min() / max(on_discs.max(), DARK_LUX)),
        "sensor_lux": float(centre * design.skin.bright_reflectance * LENS_TRANSMISSION / geometry),
        "vignetting": _vignetting(layout, imaging, on_discs / max(centre, DARK_LUX)),
        "supply_ma": light.leds * light.current_ma,
        "power_mw": led_mw + design.sensor.power_mw,
        "warming_k": _warming_k(layout, led_mw * SHARE_OF_LED_HEAT + design.sensor.power_mw),
    }


def _vignetting(layout: Layout, imaging: Imaging, lit: FloatArray) -> float:
    """Return the coefficient of the twin's quadratic law that fits lens and LEDs on the discs.

    Args:
        layout: Heights and places.
        imaging: The image of the discs.
        lit: ``(m,)`` illuminance of the discs over that of the middle.
    """
    pixels = np.array(layout.design.sensor.pixels)
    places_mm = np.array(layout.disc_places_mm)
    image_px = imaging.image_px(np.hypot(*places_mm.T))
    lens_loss = (1 - layout.design.lens.corner_light) * (2 * image_px / np.hypot(*pixels)) ** 2
    square = (2 * image_px / pixels[0]) ** 2
    fitted = square @ (1 - lit * (1 - lens_loss)) / (square @ square)
    return float(np.clip(fitted, 0.0, 0.5))


def _warming_k(layout: Layout, heat_mw: float) -> float:
    """Return the rise over still air; the underside gives nothing off: a holder may be warm too."""
    width, depth = layout.outer.size_mm
    around = math.pi * width if layout.outer.kind == "round" else 2 * (width + depth)
    area_mm2 = around * layout.design.housing.height_mm + layout.outer.area_mm2
    return heat_mw / 1000.0 / (FILM_W_M2_K * area_mm2 / MM2_PER_M2)
