"""The skin, its painted discs, and the lens: from markers in mm to ellipses on the sensor in px."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.schema import require_within
from spikingtac.types import FloatArray

NO_CELLS = np.empty(0, np.uint8)  # What a model without cells knows of the touched skin.


@dataclass(frozen=True, slots=True)
class SkinState:
    """The markers on the skin and the load at one time.

    The frame is that of the image, in mm: x right, y down, origin at the optical axis. z points
    towards the camera, so that an indentation is positive.

    Attributes:
        t_us: Time, us.
        marker_mm: ``(m, 3)`` positions of the markers, mm.
        gradient: ``(m, 2, 2)`` in-plane deformation gradient d(deformed xy) / d(rest xy).
        force_n: ``(3,)`` force of the indenter on the skin, N.
        torque_n_mm: ``(3,)`` its moment about the origin of the frame, N mm.
        pose_mm: ``(3,)`` reference point of the indenter, mm.
        in_contact: True where any pressure acts.
        touching_cells: ``(ceil(n² / 8),)`` one bit per cell of the skin at rest, set where any
            pressure acts; ``numpy.unpackbits`` gives the cells row by row. Empty without cells.
        sticking_cells: The same, set where the cell touches and does not slip.
    """

    t_us: int
    marker_mm: FloatArray
    gradient: FloatArray
    force_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    torque_n_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    pose_mm: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    in_contact: bool = False
    touching_cells: NDArray[np.uint8] = field(default_factory=NO_CELLS.copy)
    sticking_cells: NDArray[np.uint8] = field(default_factory=NO_CELLS.copy)


@dataclass(frozen=True, slots=True)
class MarkerImage:
    """Image of a :class:`SkinState` on the sensor.

    Attributes:
        t_us: Time, us.
        center_px: ``(m, 2)`` marker centres on the sensor, px.
        shape: ``(m, 2, 2)`` maps a pixel's offset from the centre (px) to the undeformed disc: the
            marker covers the pixels with ``|shape @ offset| < radius_px``.
        radius_px: ``(m,)`` radii of the undeformed discs on the sensor, px; 0 where a marker is
            missing.
        chord: ``(m, 3)`` chords of broken discs, or None if all are whole. The paint is missing
            where ``chord[:, :2] @ (shape @ offset) > chord[:, 2]``, with unit ``chord[:, :2]`` and
            ``chord[:, 2]`` in px, infinite for a whole disc.
    """

    t_us: int
    center_px: FloatArray
    shape: FloatArray
    radius_px: FloatArray
    chord: FloatArray | None = None


def image_radius_px(image: MarkerImage) -> FloatArray:
    """Return the radii ``(m,)`` of circles with the area of the discs on the image, px."""
    return image.radius_px / np.sqrt(np.abs(np.linalg.det(image.shape)))


# Most pixels of a sensor (1920 by 1080 fit); each takes 200 bytes while it is made.
MOST_PIXELS = 1 << 21

# Standard deviation of each coordinate of a disc about the grid, mm (assumed: 0.8 px).
POSITION_SIGMA_MM = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscConfig:
    """Size and tolerances of the markers, and which are damaged.

    Attributes:
        radius_mm: Mean radius, mm (the paper gives none; 0.8 to 1.0 mm across is usual).
        radius_sigma_mm: Standard deviation of the radius from disc to disc, mm (assumed: 0.25 px).
        broken: Indices of markers of which only half of the width remains.
        missing: Indices of missing markers.
    """

    radius_mm: float = 0.45
    radius_sigma_mm: float = 0.016
    broken: tuple[int, ...] = ()
    missing: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        require_within(self, radius_mm=(1e-3, 50.0), radius_sigma_mm=(0.0, 50.0))


def draw_discs(config: DiscConfig, markers: int, seed: int) -> tuple[FloatArray, ...]:
    """Draw the discs of a skin with ``markers`` markers.

    The tolerances of a marker do not depend on which other markers are broken or missing.

    Args:
        config: Sizes and damage.
        markers: Number of markers.
        seed: Seed of the tolerances.

    Returns:
        ``(m,)`` radii, mm, 0 where a marker is missing; ``(m, 2)`` offsets from the nominal places,
        mm; ``(m, 3)`` unit normal and distance (mm) of the line beyond which the paint is missing.
    """
    rng = np.random.default_rng([seed, markers])
    spread = rng.standard_normal(markers).clip(-3, 3)
    radius_mm = np.maximum(config.radius_mm + config.radius_sigma_mm * spread, 0.0)
    offset_mm = POSITION_SIGMA_MM * rng.standard_normal((markers, 2)).clip(-3, 3)
    angle = rng.uniform(0, 2 * np.pi, markers)
    chord = np.stack([np.cos(angle), np.sin(angle), np.full(markers, np.inf)], axis=1)
    chord[list(config.broken), 2] = 0.0
    radius_mm[list(config.missing)] = 0.0
    return radius_mm, offset_mm, chord


@dataclass(frozen=True, kw_only=True, slots=True)
class OpticsConfig:
    """Distance and distortion of the lens.

    The paper gives neither lens nor distance. An image of 20.6 mm on 320 px of 6.3 um inside a 19
    mm housing gives a distance of about 13 mm and a half-angle of 38 degrees at the edge.

    Attributes:
        size: ``(width, height)`` of the sensor, px (GenX320).
        px_per_mm: Image scale on the optical axis at rest (320 px over the paper's 20.6 mm).
        distance_mm: Distance from the lens's centre of projection to the skin at rest, mm.
        k1: Brown's first radial coefficient, in units of the tangent of the view angle (assumed: a
            mild barrel, 2 % at the middle of an edge of the marker grid).
        k2: Brown's second radial coefficient.
        discs: The discs of the markers and their defects.
    """

    size: tuple[int, int] = (320, 320)
    px_per_mm: float = 15.5
    distance_mm: float = 13.0
    k1: float = -0.05
    k2: float = 0.0
    discs: DiscConfig = field(default_factory=DiscConfig)

    def __post_init__(self) -> None:
        if min(self.size) < 1 or self.size[0] * self.size[1] > MOST_PIXELS:
            raise ValueError(
                f"size is {list(self.size)}, valid are 1 to {MOST_PIXELS} pixels in all"
            )
        require_within(self, px_per_mm=(0.1, 1e4), distance_mm=(0.5, 1e3))
        corner = np.hypot(*self.size) / 2 / (self.px_per_mm * self.distance_mm)
        tangent_sq = np.linspace(0.0, corner, 100) ** 2
        if (1 + 3 * self.k1 * tangent_sq + 5 * self.k2 * tangent_sq**2 <= 0).any():
            raise ValueError(
                f"k1 = {self.k1}, k2 = {self.k2} fold the image over itself inside the sensor; "
                "choose coefficients nearer to 0"
            )


class Optics:
    """Pinhole camera with Brown distortion. Indentation magnifies; strain makes ellipses of discs.

    The perspective of a tilted skin across one marker is neglected, because the gel gives its
    in-plane gradient only.

    Args:
        config: Lens, distance and discs.
        seed: Seed of the discs' fabrication tolerances. Equal seeds give the same sensor.
    """

    def __init__(self, config: OpticsConfig, seed: int = 0) -> None:
        self._config, self._seed = config, seed
        self._radius_px = np.empty(0)

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the ``m`` markers of a skin."""
        config, markers = self._config, len(state.marker_mm)
        if len(self._radius_px) != markers:
            radius_mm, self._offset_mm, chord = draw_discs(config.discs, markers, self._seed)
            self._radius_px = radius_mm * config.px_per_mm
            self._chord = chord * np.array([1.0, 1.0, config.px_per_mm])
        center_px, shape = np.empty((markers, 2)), np.empty((markers, 2, 2))
        place, lens = np.asarray(state.marker_mm, np.float64), (*config.size, config.px_per_mm)
        lens = (*lens, config.distance_mm, config.k1, config.k2)
        project_kernel(lens, place, state.gradient, self._offset_mm, center_px, shape)
        return MarkerImage(state.t_us, center_px, shape, self._radius_px, self._chord)


@njit(cache=True, nogil=True, error_model="numpy")
def project_kernel(
    lens: tuple[int, int, float, float, float, float],
    marker_mm: FloatArray,
    gradient: FloatArray,
    offset_mm: FloatArray,
    center_px: FloatArray,
    shape: FloatArray,
) -> None:
    """Write the centres ``(m, 2)`` of the markers, px, and their shapes ``(m, 2, 2)``.

    Args:
        lens: Width and height, px; scale, px/mm; distance, mm; the coefficients k1 and k2.
        marker_mm: ``(m, 3)`` places on the skin, mm.
        gradient: ``(m, 2, 2)`` deformation gradient there.
        offset_mm: ``(m, 2)`` offsets of the discs from their nominal places at rest, mm.
        center_px: Overwritten.
        shape: Overwritten; see :class:`MarkerImage`.
    """
    width, height, px_per_mm, distance_mm, k1, k2 = lens
    focal_px = px_per_mm * distance_mm
    for k in range(len(marker_mm)):
        g_xx, g_xy = gradient[k, 0, 0], gradient[k, 0, 1]
        g_yx, g_yy = gradient[k, 1, 0], gradient[k, 1, 1]
        dx, dy = offset_mm[k, 0], offset_mm[k, 1]
        scale = 1.0 / (distance_mm - marker_mm[k, 2])
        x = (marker_mm[k, 0] + g_xx * dx + g_xy * dy) * scale
        y = (marker_mm[k, 1] + g_yx * dx + g_yy * dy) * scale
        square = x * x + y * y
        radial = 1 + k1 * square + k2 * square**2
        slope = 2 * (k1 + 2 * k2 * square)
        center_px[k, 0] = (width - 1) / 2 + focal_px * (x * radial)
        center_px[k, 1] = (height - 1) / 2 + focal_px * (y * radial)
        steep = focal_px * scale  # d px / d mm follows: along x, along y, across
        along_x, along_y = steep * (radial + slope * x * x), steep * (radial + slope * y * y)
        across = steep * (slope * x * y)
        xx, xy = along_x * g_xx + across * g_yx, along_x * g_xy + across * g_yy
        yx, yy = across * g_xx + along_y * g_yx, across * g_xy + along_y * g_yy
        shrink = px_per_mm / (xx * yy - xy * yx)
        shape[k, 0, 0], shape[k, 0, 1] = shrink * yy, -shrink * xy
        shape[k, 1, 0], shape[k, 1, 1] = -shrink * yx, shrink * xx
