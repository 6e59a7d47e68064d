"""From the lens's data sheet to pixels, the twin's lens, and the light of the LEDs.

Window and gel are plane plates between the lens and the discs. They bend every ray, so that the
discs seem nearer than they are, and the image gains a pincushion that partly undoes the barrel of a
wide-angle lens. The entrance pupil is taken as the lens's centre of projection.

An LED is a Lambertian source that looks at the skin; the pillars of the shell cast shadows. For
light, window and gel are taken as air of their reduced thickness. Light that walls and skin send
back is left out, so that the real skin is brighter.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import FloatArray
from spikingtac_hardware.layout import Layout

UM_PER_MM = 1000.0
NEWTON_STEPS = 12  # Steps to the tangent of a ray; six reach the last digit at 60 degrees.
FIT_POINTS = 200  # Radii at which the twin's lens is fitted.
MM2_PER_M2 = 1e6
DARK_LUX = 1e-6  # Illuminance that stands for none where one is divided by it, lx.
LENS_TRANSMISSION = 0.9  # Share of the light that a coated lens lets through (class).

# Heat transfer to still air by convection and radiation, W/(m² K) (textbook: 5 to 15).
FILM_W_M2_K = 10.0

# Share of the LEDs' electrical power that stays as heat (class: the rest is light).
SHARE_OF_LED_HEAT = 0.75


class Imaging:
    """The image of the discs.

    Args:
        layout: Heights of the parts; the entrance pupil must lie below the window.

    Attributes:
        air_mm: Distance from the entrance pupil to the window, mm.
        reduced_mm: Air plus each plate over its refractive index: the distance at which the discs
            seem to stand, mm.
        magnification: Image over object on the axis.
        px_per_mm: Scale on the axis, px/mm.
    """

    def __init__(self, layout: Layout) -> None:
        design = layout.design
        self._lens, self._sensor, self._skin = design.lens, design.sensor, design.skin
        self._k1 = design.lens_k1
        self._plates = (
            (design.window.thickness_mm, design.window.index),
            (design.skin.gel_mm, design.skin.gel_index),
        )
        self.air_mm = layout.window_bottom_mm - layout.pupil_mm
        self.reduced_mm = self.air_mm + sum(thick / index for thick, index in self._plates)
        self.magnification = self._lens.focal_mm / (self.reduced_mm - self._lens.focal_mm)
        self.px_per_mm = self.magnification * UM_PER_MM / self._sensor.pixel_um
        self._disc_reach_mm = layout.disc_reach_mm
        self._skin_reach_mm = layout.window.reach_mm

    def radius_mm(self, tangent: FloatArray, from_window_mm: float | None = None) -> FloatArray:
        """Return where rays arrive, by Snell's law through both plates.

        Args:
            tangent: ``(n,)`` tangents of the angles between ray and axis, in air.
            from_window_mm: Height above the window's lower side at which to look, mm; None is the
                plane of the discs.

        Returns:
            ``(n,)`` distances from the axis, mm.
        """
        left = math.inf if from_window_mm is None else from_window_mm
        radius = tangent * self.air_mm
        for thick, index in self._plates:
            radius = radius + max(min(thick, left), 0.0) * _slope(tangent, index)
            left -= thick
        return radius

    def tangent(self, radius_mm: FloatArray) -> FloatArray:
        """Return the tangents ``(n,)`` in air of the rays to discs at ``(n,)`` distances, mm."""
        tangent = radius_mm / self.reduced_mm
        for _ in range(NEWTON_STEPS):
            excess = self.radius_mm(tangent) - radius_mm
            tangent = tangent - excess / self._radius_per_tangent(tangent)
        return tangent

    def image_px(self, radius_mm: FloatArray) -> FloatArray:
        """Return the distances ``(n,)`` of images from the centre, px."""
        tangent = self.tangent(radius_mm)
        return self.px_per_mm * self.reduced_mm * tangent * (1 + self._k1 * tangent**2)

    def seen_mm(self, image_px: float) -> float:
        """Return the distance on the skin that is imaged at ``image_px`` from the centre, mm."""
        radius_mm = np.linspace(0.0, 2 * image_px / self.px_per_mm, 20 * FIT_POINTS)
        image = np.maximum.accumulate(self.image_px(radius_mm))
        return float(np.interp(image_px, image, radius_mm))

    @property
    def field_mm(self) -> tuple[float, float]:
        """``(width, depth)`` that the sensor sees along its two middle lines, mm."""
        width, height = self._sensor.pixels
        return 2 * self.seen_mm(width / 2), 2 * self.seen_mm(height / 2)

    @property
    def corner_angle_deg(self) -> float:
        """Angle in air between the axis and the farthest ray of use, degrees.

        It leads to the corner of the skin, or to that of the sensor where the sensor sees less.
        """
        seen_mm = self.seen_mm(math.hypot(*self._sensor.pixels) / 2)
        corner_mm = min(seen_mm, self._skin_reach_mm)
        return math.degrees(math.atan(float(self.tangent(np.array([corner_mm]))[0])))

    def blur_px(self, indentation_mm: float) -> float:
        """Return the diameter of the blur disc of the skin under an indentation, on the axis, px.

        The lens is focused on the skin at rest. The gel above the disc becomes thinner, so that the
        apparent distance shrinks by the indentation over the gel's index.
        """
        focal, far = self._lens.focal_mm, self.reduced_mm
        near = far - indentation_mm / self._skin.gel_index
        blur_mm = focal**2 / self._lens.f_number * (far - near) / (near * (far - focal))
        return abs(blur_mm) * UM_PER_MM / self._sensor.pixel_um

    def twin_lens(self) -> dict[str, float]:
        """Return the twin's lens, fitted to rays over the field of the discs.

        ``px_per_mm``, ``distance_mm``, ``k1`` and ``k2`` are those of the twin's optics,
        ``residual_px`` is the largest distance of the fitted from the traced image, px.

        The coefficients are fitted to the image at rest, the distance to its motion under
        indentation: the twin has no plates, and one distance cannot give both.
        """
        radius_mm = np.linspace(0.0, self._disc_reach_mm, FIT_POINTS + 1)[1:]
        image_px = self.image_px(radius_mm)
        square = radius_mm**2
        powers = np.stack([square, square**2], axis=1) * radius_mm[:, None]
        wanted = image_px / self.px_per_mm - radius_mm
        first, second = np.linalg.lstsq(powers, wanted, rcond=None)[0]
        fitted_px = self.px_per_mm * (radius_mm + powers @ np.array([first, second]))
        # The twin: d px / d mm of indentation = scale r (1 + 3 first r² + 5 second r⁴) / distance.
        model = self.px_per_mm * radius_mm * (1 + 3 * first * square + 5 * second * square**2)
        traced = self._px_per_mm_of_indentation(radius_mm)
        distance = float(model @ model / (model @ traced))
        return {
            "px_per_mm": self.px_per_mm,
            "distance_mm": distance,
            "k1": float(first * distance**2),
            "k2": float(second * distance**4),
            "residual_px": float(np.abs(fitted_px - image_px).max()),
        }

    def _px_per_mm_of_indentation(self, radius_mm: FloatArray) -> FloatArray:
        tangent = self.tangent(radius_mm)
        per_tangent = self.px_per_mm * self.reduced_mm * (1 + 3 * self._k1 * tangent**2)
        lost = _slope(tangent, self._skin.gel_index)
        return per_tangent * lost / self._radius_per_tangent(tangent)

    def _radius_per_tangent(self, tangent: FloatArray) -> FloatArray:
        slope = np.full_like(tangent, self.air_mm)
        for thick, index in self._plates:
            slope += thick * index**2 / (index**2 + (index**2 - 1) * tangent**2) ** 1.5
        return slope


def _slope(tangent: FloatArray, index: float) -> FloatArray:
    """Return the tangent of a ray inside a plate, from the one in air."""
    return tangent / np.sqrt(index**2 + (index**2 - 1) * tangent**2)


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
