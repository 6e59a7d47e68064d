"""Surface displacement of a bonded elastic layer under traction: four closed forms.

The layer is incompressible, linear and isotropic, bonded to a rigid base, of thickness h. Frame: x
right, y down, z into the layer (towards the camera), so that pressure and indentation are positive.
All responses are for unit shear modulus; multiply by the compliance 1/mu.

The response to a point force is a sum of Bessel functions of the layer's response over all
wavenumbers (a Hankel transform); a disc of pressure smooths it. The layer has no sides: markers
nearer to the rim of a real skin than its thickness move less than this says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from spikingtac.errors import ConfigError

Field = NDArray[np.float64]

# Limit of kh, before cosh overflows; 1/cosh² is zero in double precision long before.
MAX_ARGUMENT = 300.0


@dataclass(frozen=True, slots=True)
class LayerResponse:
    """Surface displacement per traction exp(i k x), in mm at unit modulus, over wavenumbers.

    Attributes:
        normal: Normal displacement under pressure.
        coupling: Outward lateral displacement under pressure, as the factor of ``-i k/|k|``.
        longitudinal: Lateral displacement along the wave under lateral traction along it.
        transverse: Lateral displacement across the wave under lateral traction across it.
    """

    normal: Field
    coupling: Field
    longitudinal: Field
    transverse: Field


def layer_response(wavenumber_per_mm: Field, thickness_mm: float) -> LayerResponse:
    """Return the four responses of a bonded incompressible layer.

    With x = kh and D = cosh² x + x²: normal (sinh x cosh x - x) / (2 k D), longitudinal
    (sinh x cosh x + x) / (2 k D), coupling x² / (2 k D), transverse tanh(x) / k; at k = 0 the
    layer only shears: 0, h, 0, h. Derived from the Stokes form of incompressible elasticity and
    tested against a numeric solution of its equations.

    Args:
        wavenumber_per_mm: Wavenumbers k, any shape, 1/mm, not negative.
        thickness_mm: Thickness h, mm.
    """
    flat = wavenumber_per_mm <= 0.0
    k = np.where(flat, 1.0, wavenumber_per_mm)
    x = np.minimum(k * thickness_mm, MAX_ARGUMENT)
    tanh, sech2 = np.tanh(x), 1.0 / np.cosh(x) ** 2
    scale = 0.5 / (k * (1.0 + x**2 * sech2))
    return LayerResponse(
        normal=np.where(flat, 0.0, (tanh - x * sech2) * scale),
        coupling=np.where(flat, 0.0, x**2 * sech2 * scale),
        longitudinal=np.where(flat, thickness_mm, (tanh + x * sech2) * scale),
        transverse=np.where(flat, thickness_mm, tanh / k),
    )


KPA_PER_MPA = 1e3
WAVENUMBERS = 400  # Steps of the integral over wavenumbers (800 give the same to 1e-4).

# Largest wavenumber times smoothing radius; the smoothing leaves exp(-32) there.
LARGEST_ARGUMENT = 8.0
TABLE_POINTS = 400  # Distances at which the response is tabulated; in between it is linear.


@dataclass(frozen=True, kw_only=True)
class SkinConfig:
    """An elastic skin, bonded to a rigid window.

    Attributes:
        shear_modulus_kpa: Shear modulus mu at once, kPa.
        thickness_mm: Thickness, mm.
        camera_distance_mm: From the lens's centre of projection to the skin at rest, mm. Where the
            skin is pressed towards the camera, markers move away from the middle of the image, as
            much as a press moves them along the skin. None where this is not seen.
    """

    shear_modulus_kpa: float = 30.0
    thickness_mm: float = 3.0
    camera_distance_mm: float | None = None

    def __post_init__(self) -> None:
        if not self.shear_modulus_kpa > 0 or not self.thickness_mm > 0:
            raise ConfigError(
                f"shear_modulus_kpa is {self.shear_modulus_kpa} and thickness_mm is "
                f"{self.thickness_mm}, both must be positive"
            )
        if self.camera_distance_mm is not None and not self.camera_distance_mm > self.thickness_mm:
            raise ConfigError(
                f"camera_distance_mm is {self.camera_distance_mm}, it must be more than the "
                f"skin's thickness, {self.thickness_mm} mm: the camera looks through the gel"
            )


class SurfaceResponse:
    """Displacement of the surface per unit force at a place, for one skin.

    Forces are spread as a Gaussian of the given radius, so that nothing is infinite.
    """

    def __init__(self, skin: SkinConfig, radius_mm: float, reach_mm: float) -> None:
        """Tabulate the responses up to a distance.

        Args:
            skin: The skin.
            radius_mm: Standard deviation of the Gaussian over which a force is spread, mm.
            reach_mm: Largest distance asked for, mm.
        """
        compliance = KPA_PER_MPA / skin.shear_modulus_kpa
        largest = LARGEST_ARGUMENT / radius_mm
        k = (np.arange(WAVENUMBERS) + 0.5) * largest / WAVENUMBERS
        response = layer_response(k, skin.thickness_mm)
        weight = compliance * np.exp(-0.5 * (k * radius_mm) ** 2) * k / (2.0 * np.pi)
        weight = weight * largest / WAVENUMBERS
        self._distance = np.linspace(0.0, reach_mm, TABLE_POINTS)
        zero, first, second = (jv(order, self._distance[:, None] * k) for order in (0, 1, 2))
        mean = 0.5 * (response.longitudinal + response.transverse)
        half = 0.5 * (response.longitudinal - response.transverse)
        # Outward and inward under pressure; along the force, and twofold about it.
        self._tables = (
            first @ (weight * response.coupling),
            zero @ (weight * response.normal),
            zero @ (weight * mean),
            -second @ (weight * half),
        )

    def matrix(self, places_mm: Field, sources_mm: Field) -> Field:
        """Return the response at places to forces at sources.

        Args:
            places_mm: ``(m, 2)`` markers at rest, mm (x right, y down).
            sources_mm: ``(c, 2)`` where forces act, mm.

        Returns:
            ``(m, 3, c, 3)`` displacement along x, along y and towards the camera, mm per N along
            x, along y and pressing.
        """
        away = places_mm[:, None] - sources_mm[None]
        distance = np.sqrt((away**2).sum(axis=2))
        cosine, sine = np.moveaxis(away / np.maximum(distance, 1e-9)[..., None], -1, 0)
        outward, deep, even, twofold = (
            np.interp(distance, self._distance, table) for table in self._tables
        )
        c2, s2 = cosine**2 - sine**2, 2.0 * cosine * sine
        # By reciprocity a lateral force lifts a place as much as pressing there would move it.
        rows = (
            (even + twofold * c2, twofold * s2, outward * cosine),
            (twofold * s2, even - twofold * c2, outward * sine),
            (-outward * cosine, -outward * sine, deep),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
