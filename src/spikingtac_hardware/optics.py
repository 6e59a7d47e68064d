"""From the lens's data sheet to pixels: rays through window and gel, and the twin's lens.

Window and gel are plane plates between the lens and the discs. They bend every ray, so that the
discs seem nearer than they are, and the image gains a pincushion that partly undoes the barrel of a
wide-angle lens. The entrance pupil is taken as the lens's centre of projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac_hardware.layout import Layout

UM_PER_MM = 1000.0
NEWTON_STEPS = 12  # Steps to the tangent of a ray; six reach the last digit at 60 degrees.
FIT_POINTS = 200  # Radii at which the twin's lens is fitted.


@dataclass(frozen=True, slots=True)
class TwinLens:
    """The lens of the twin that images the discs as the design does.

    Attributes:
        px_per_mm: Scale on the axis, px/mm.
        distance_mm: Distance that gives the right motion under indentation, mm.
        k1: Brown's first radial coefficient.
        k2: Brown's second one.
        residual_px: Largest distance of the fitted from the traced image, px.
    """

    px_per_mm: float
    distance_mm: float
    k1: float
    k2: float
    residual_px: float


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

    def twin_lens(self) -> TwinLens:
        """Return the twin's lens, fitted to rays over the field of the discs.

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
        return TwinLens(
            px_per_mm=self.px_per_mm,
            distance_mm=distance,
            k1=float(first * distance**2),
            k2=float(second * distance**4),
            residual_px=float(np.abs(fitted_px - image_px).max()),
        )

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
