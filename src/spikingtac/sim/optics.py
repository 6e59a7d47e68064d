"""The lens of the twin: from markers in mm on the skin to ellipses in px on the sensor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim.discs import DiscConfig, Discs, draw_discs
from spikingtac.sim.skin import MarkerImage, SkinState


@dataclass(frozen=True, kw_only=True, slots=True)
class OpticsConfig:
    """Where the camera stands and how its lens bends.

    The paper gives neither lens nor distance; 20.6 mm imaged on 320 px of 6.3 um inside a 19 mm
    housing leave a distance of about 13 mm and a half-angle of 38 degrees at the edge.

    Attributes:
        size: ``(width, height)`` of the sensor, px (GenX320).
        px_per_mm: Image scale on the optical axis at rest (320 px over the paper's 20.6 mm).
        center_px: Where the optical axis meets the sensor; None is the sensor's centre.
        distance_mm: From the lens's centre of projection to the skin at rest.
        k1: Brown's first radial coefficient, in units of the tangent of the view angle (assumed:
            a mild barrel, 2 % at the middle of an edge of the marker grid).
        k2: Brown's second radial coefficient.
        p1: Brown's first tangential coefficient.
        p2: Brown's second tangential coefficient.
        discs: The markers' discs and their defects.
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


class Optics:
    """Pinhole with Brown distortion; an indentation magnifies, a strain makes ellipses.

    The perspective of a tilted skin across one marker is left out: its in-plane gradient is all
    that the gel reports.

    Args:
        config: Lens, distance and discs.
        seed: Of the discs' fabrication tolerances: equal seeds are one and the same sensor.
    """

    def __init__(self, config: OpticsConfig, seed: int = 0) -> None:
        width, height = config.size
        center = config.center_px or ((width - 1) / 2, (height - 1) / 2)
        self._config = config
        self._seed = seed
        self._center_px = np.array(center, np.float64)
        self._discs: Discs | None = None

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers.

        Args:
            state: Skin with m markers.
        """
        discs = self._discs_of(len(state.marker_mm))
        place_mm = state.marker_mm.astype(np.float64)
        place_mm[:, :2] += np.einsum("mij,mj->mi", state.gradient, discs.offset_mm)
        center_px, jacobian = self._bend(place_mm)
        stretch = jacobian @ state.gradient
        return MarkerImage(
            t_us=state.t_us,
            center_px=center_px,
            shape=(self._config.px_per_mm * np.linalg.inv(stretch)).astype(np.float64),
            radius_px=discs.radius_mm * self._config.px_per_mm,
            chord=discs.chord_px(self._config.px_per_mm),
        )

    def project_points(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where ``(n, 3)`` points of the skin's frame (mm) fall on the sensor, (n, 2) px."""
        return self._bend(np.asarray(points_mm, np.float64))[0]

    def _bend(
        self, points_mm: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``(n, 2)`` px and the Jacobian d px / d mm ``(n, 2, 2)`` at ``(n, 3)`` points."""
        lens = self._config
        scale = 1.0 / (lens.distance_mm - points_mm[:, 2])
        x, y = points_mm[:, 0] * scale, points_mm[:, 1] * scale
        square = x * x + y * y
        radial = 1 + lens.k1 * square + lens.k2 * square**2
        slope = 2 * (lens.k1 + 2 * lens.k2 * square)
        bent = np.stack(
            [
                x * radial + 2 * lens.p1 * x * y + lens.p2 * (square + 2 * x * x),
                y * radial + lens.p1 * (square + 2 * y * y) + 2 * lens.p2 * x * y,
            ],
            axis=1,
        )
        cross = slope * x * y + 2 * (lens.p1 * x + lens.p2 * y)
        jacobian = np.empty((len(points_mm), 2, 2))
        jacobian[:, 0, 0] = radial + slope * x * x + 2 * lens.p1 * y + 6 * lens.p2 * x
        jacobian[:, 1, 1] = radial + slope * y * y + 6 * lens.p1 * y + 2 * lens.p2 * x
        jacobian[:, 0, 1] = jacobian[:, 1, 0] = cross
        focal_px = lens.px_per_mm * lens.distance_mm
        return self._center_px + focal_px * bent, (focal_px * scale)[:, None, None] * jacobian

    def _discs_of(self, markers: int) -> Discs:
        if self._discs is None or len(self._discs.radius_mm) != markers:
            self._discs = draw_discs(self._config.discs, markers, self._seed)
        return self._discs
