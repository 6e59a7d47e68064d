"""The lens: from markers on the skin (mm) to ellipses on the sensor (px)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.sim.optics.discs import DiscConfig, Discs, draw_discs
from spikingtac.sim.optics.states import MarkerImage, SkinState


@dataclass(frozen=True, kw_only=True, slots=True)
class OpticsConfig:
    """Distance and distortion of the lens.

    The paper gives neither lens nor distance. An image of 20.6 mm on 320 px of 6.3 um inside a 19
    mm housing gives a distance of about 13 mm and a half-angle of 38 degrees at the edge.

    Attributes:
        size: ``(width, height)`` of the sensor, px (GenX320).
        px_per_mm: Image scale on the optical axis at rest (320 px over the paper's 20.6 mm).
        center_px: Place of the optical axis on the sensor, px; None is the sensor's centre.
        distance_mm: Distance from the lens's centre of projection to the skin at rest, mm.
        k1: Brown's first radial coefficient, in units of the tangent of the view angle (assumed: a
            mild barrel, 2 % at the middle of an edge of the marker grid).
        k2: Brown's second radial coefficient.
        p1: Brown's first tangential coefficient.
        p2: Brown's second tangential coefficient.
        discs: The discs of the markers and their defects.
    """

    size: tuple[int, int] = (320, 320)
    px_per_mm: float = 15.5
    center_px: tuple[float, float] | None = None
    distance_mm: float = 13.0
    k1: float = -0.05
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    discs: DiscConfig = field(default_factory=DiscConfig)

    def __post_init__(self) -> None:
        if min(self.size) < 1:
            raise ValueError(f"size is {self.size}, both numbers must be positive")
        if not (self.px_per_mm > 0 and self.distance_mm > 0):
            raise ValueError("px_per_mm and distance_mm must be positive")
        corner = np.hypot(*self.size) / 2 / (self.px_per_mm * self.distance_mm)
        tangent_sq = np.linspace(0.0, corner, 100) ** 2
        if (1 + 3 * self.k1 * tangent_sq + 5 * self.k2 * tangent_sq**2 <= 0).any():
            raise ValueError(
                f"k1 = {self.k1}, k2 = {self.k2} fold the image over itself inside the sensor; "
                "choose coefficients nearer to 0"
            )


class Lens(NamedTuple):
    """Parameters of :func:`distort_kernel`; see :class:`OpticsConfig`."""

    center_x_px: float
    center_y_px: float
    px_per_mm: float
    distance_mm: float
    k1: float
    k2: float
    p1: float
    p2: float


class Optics:
    """Pinhole camera with Brown distortion. Indentation magnifies; strain makes ellipses of discs.

    The perspective of a tilted skin across one marker is neglected, because the gel gives its
    in-plane gradient only.

    Args:
        config: Lens, distance and discs.
        seed: Seed of the discs' fabrication tolerances. Equal seeds give the same sensor.
    """

    def __init__(self, config: OpticsConfig, seed: int = 0) -> None:
        width, height = config.size
        center = config.center_px or ((width - 1) / 2, (height - 1) / 2)
        self._config = config
        self._seed = seed
        terms = config.px_per_mm, config.distance_mm, config.k1, config.k2, config.p1, config.p2
        self._lens = Lens(*map(float, (*center, *terms)))
        self._discs: Discs | None = None

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers.

        Args:
            state: Skin with m markers.
        """
        discs = self._discs_for(len(state.marker_mm))
        center_px, shape = project_kernel(
            state.marker_mm, state.gradient, discs.offset_mm, self._lens
        )
        return MarkerImage(
            t_us=state.t_us,
            center_px=center_px,
            shape=shape,
            radius_px=discs.radius_mm * self._config.px_per_mm,
            chord=discs.chord_px(self._config.px_per_mm),
        )

    def _discs_for(self, markers: int) -> Discs:
        if self._discs is None or len(self._discs.radius_mm) != markers:
            self._discs = draw_discs(self._config.discs, markers, self._seed)
        return self._discs


@njit(cache=True, nogil=True, error_model="numpy")
def distort_kernel(
    lens: Lens, x_mm: float, y_mm: float, z_mm: float
) -> tuple[float, float, float, float, float]:
    """Return the image of a point, px, and d px / d mm there: along x, along y, across."""
    scale = 1.0 / (lens.distance_mm - z_mm)
    x, y = x_mm * scale, y_mm * scale
    square = x * x + y * y
    radial = 1 + lens.k1 * square + lens.k2 * square**2
    slope = 2 * (lens.k1 + 2 * lens.k2 * square)
    distorted_x = x * radial + 2 * lens.p1 * x * y + lens.p2 * (square + 2 * x * x)
    distorted_y = y * radial + lens.p1 * (square + 2 * y * y) + 2 * lens.p2 * x * y
    along_x = radial + slope * x * x + 2 * lens.p1 * y + 6 * lens.p2 * x
    along_y = radial + slope * y * y + 6 * lens.p1 * y + 2 * lens.p2 * x
    across = slope * x * y + 2 * (lens.p1 * x + lens.p2 * y)
    focal_px = lens.px_per_mm * lens.distance_mm
    steep = focal_px * scale
    return (
        lens.center_x_px + focal_px * distorted_x,
        lens.center_y_px + focal_px * distorted_y,
        steep * along_x,
        steep * along_y,
        steep * across,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def project_kernel(
    marker_mm: NDArray[np.float64], gradient: NDArray[np.float64], offset_mm: Any, lens: Lens
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres ``(m, 2)`` (px) and shapes ``(m, 2, 2)`` of a :class:`MarkerImage`.

    Args:
        marker_mm: ``(m, 3)`` nominal places on the skin, mm.
        gradient: ``(m, 2, 2)`` deformation gradient of the skin there.
        offset_mm: ``(m, 2)`` offsets of the discs from their nominal places, in the rest frame, mm.
        lens: Parameters of the lens.
    """
    center_px, shape = np.empty((len(marker_mm), 2)), np.empty((len(marker_mm), 2, 2))
    for k in range(len(marker_mm)):
        strain, (dx, dy) = gradient[k], (offset_mm[k, 0], offset_mm[k, 1])
        x_mm = marker_mm[k, 0] + strain[0, 0] * dx + strain[0, 1] * dy
        y_mm = marker_mm[k, 1] + strain[1, 0] * dx + strain[1, 1] * dy
        x_px, y_px, along_x, along_y, across = distort_kernel(lens, x_mm, y_mm, marker_mm[k, 2])
        center_px[k, 0], center_px[k, 1] = x_px, y_px
        xx = along_x * strain[0, 0] + across * strain[1, 0]
        xy = along_x * strain[0, 1] + across * strain[1, 1]
        yx = across * strain[0, 0] + along_y * strain[1, 0]
        yy = across * strain[0, 1] + along_y * strain[1, 1]
        shrink = lens.px_per_mm / (xx * yy - xy * yx)
        shape[k, 0, 0], shape[k, 0, 1] = shrink * yy, -shrink * xy
        shape[k, 1, 0], shape[k, 1, 1] = -shrink * yx, shrink * xx
    return center_px, shape
