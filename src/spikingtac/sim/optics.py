"""The lens: from markers on the skin (mm) to ellipses on the sensor (px), with their defects.

The painted discs of a skin: fabrication tolerances, broken and missing discs.

The lens: from markers on the skin (mm) to ellipses on the sensor (px).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac.schema import require_within
from spikingtac.sim.states import MarkerImage, SkinState


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscConfig:
    """Size and tolerances of the markers, and which are damaged.

    Attributes:
        radius_mm: Mean radius, mm (the paper gives none; 0.8 to 1.0 mm across is usual).
        radius_sigma_mm: Standard deviation of the radius from disc to disc, mm (assumed: 0.25 px).
        position_sigma_mm: Standard deviation of each coordinate about the grid, mm (assumed: 0.8
            px).
        broken: Indices of markers of which only ``broken_share`` of the width remains.
        broken_share: Fraction of the diameter that a broken marker keeps, 0 to 1.
        missing: Indices of missing markers.
    """

    radius_mm: float = 0.45
    radius_sigma_mm: float = 0.016
    position_sigma_mm: float = 0.05
    broken: tuple[int, ...] = ()
    broken_share: float = 0.5
    missing: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        require_within(self, radius_mm=(1e-3, 50.0), radius_sigma_mm=(0.0, 50.0))
        require_within(self, position_sigma_mm=(0.0, 50.0), broken_share=(0.01, 1.0))


@dataclass(frozen=True, slots=True)
class Discs:
    """The discs of one skin.

    Attributes:
        radius_mm: ``(m,)`` radii, mm; 0 where a marker is missing.
        offset_mm: ``(m, 2)`` offsets from the nominal places, in the rest frame, mm.
        chord: ``(m, 3)`` unit normal and distance (mm) of the line beyond which the paint is
            missing.
    """

    radius_mm: NDArray[np.float64]
    offset_mm: NDArray[np.float64]
    chord: NDArray[np.float64]

    def chord_px(self, px_per_mm: float) -> NDArray[np.float64] | None:
        """Return the chords in px as in :class:`MarkerImage`, or None if all discs are whole."""
        if np.isinf(self.chord[:, 2]).all():
            return None
        return self.chord * np.array([1.0, 1.0, px_per_mm])


def draw_discs(config: DiscConfig, markers: int, seed: int) -> Discs:
    """Draw the discs of a skin with ``markers`` markers.

    The tolerances of a marker do not depend on which other markers are broken or missing.

    Args:
        config: Sizes and damage.
        markers: Number of markers.
        seed: Seed of the tolerances.

    Raises:
        ValueError: A broken or missing index is not a marker.
    """
    for index in (*config.broken, *config.missing):
        if not 0 <= index < markers:
            raise ValueError(f"marker {index} does not exist, valid are 0 to {markers - 1}")
    rng = np.random.default_rng([seed, markers])
    spread = rng.standard_normal(markers).clip(-3, 3)
    radius_mm = np.maximum(config.radius_mm + config.radius_sigma_mm * spread, 0.0)
    offset_mm = config.position_sigma_mm * rng.standard_normal((markers, 2)).clip(-3, 3)
    angle = rng.uniform(0, 2 * np.pi, markers)
    chord = np.stack([np.cos(angle), np.sin(angle), np.full(markers, np.inf)], axis=1)
    broken = list(config.broken)
    chord[broken, 2] = (2 * config.broken_share - 1) * radius_mm[broken]
    radius_mm[list(config.missing)] = 0.0
    return Discs(radius_mm=radius_mm, offset_mm=offset_mm, chord=chord)


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
        if min(self.size) < 1:
            raise ValueError(f"size is {self.size}, both numbers must be positive")
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
        self._discs: Discs | None = None

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers.

        Args:
            state: Skin with m markers.
        """
        discs, px_per_mm = self._discs_for(len(state.marker_mm)), self._config.px_per_mm
        (g_xx, g_xy), (g_yx, g_yy) = state.gradient.transpose(1, 2, 0)
        (x_mm, y_mm, z_mm), (dx, dy) = state.marker_mm.T, discs.offset_mm.T
        x_mm, y_mm = x_mm + g_xx * dx + g_xy * dy, y_mm + g_yx * dx + g_yy * dy
        center, (along_x, along_y, across) = distort(self._config, x_mm, y_mm, z_mm)
        xx, xy = along_x * g_xx + across * g_yx, along_x * g_xy + across * g_yy
        yx, yy = across * g_xx + along_y * g_yx, across * g_xy + along_y * g_yy
        shrink = px_per_mm / (xx * yy - xy * yx)
        undo = np.stack((shrink * yy, -shrink * xy, -shrink * yx, shrink * xx), axis=1)
        return MarkerImage(
            t_us=state.t_us,
            center_px=np.stack(center, axis=1),
            shape=undo.reshape(-1, 2, 2),
            radius_px=discs.radius_mm * px_per_mm,
            chord=discs.chord_px(px_per_mm),
        )

    def _discs_for(self, markers: int) -> Discs:
        if self._discs is None or len(self._discs.radius_mm) != markers:
            self._discs = draw_discs(self._config.discs, markers, self._seed)
        return self._discs


Arrays = tuple[FloatArray, ...]


def distort(
    config: OpticsConfig, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray
) -> tuple[Arrays, Arrays]:
    """Return the images of points, px, and d px / d mm there: along x, along y, across."""
    scale = 1.0 / (config.distance_mm - z_mm)
    x, y = x_mm * scale, y_mm * scale
    square = x * x + y * y
    radial = 1 + config.k1 * square + config.k2 * square**2
    slope = 2 * (config.k1 + 2 * config.k2 * square)
    focal_px = config.px_per_mm * config.distance_mm
    width, height = config.size
    center = (width - 1) / 2 + focal_px * (x * radial), (height - 1) / 2 + focal_px * (y * radial)
    steep = focal_px * scale
    slopes = radial + slope * x * x, radial + slope * y * y, slope * x * y
    return center, tuple(steep * part for part in slopes)
