"""From the image to the flat skin, where the lens distorts or the camera is tilted.

One radial coefficient by the division model, u = s / (1 + k s^2) (Fitzgibbon, CVPR 2001), where s
is the place relative to the image's centre over half of its diagonal; then a homography from u to
the skin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

LARGEST_RADIAL = 0.9
"""Beyond 1 the model folds the image over itself inside of the sensor."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Lens:
    """Where on the flat skin a pixel looks.

    Attributes:
        center_px: ``(x, y)`` about which the image is distorted: the sensor's centre.
        half_diagonal_px: Distance at which s is 1.
        radial: The coefficient k; negative for a barrel.
        radial_sigma: Its standard error.
        homography: ``(3, 3)`` from (u, 1) to the skin, mm; its axes are those of the image.
        residual_mm: What the grid's markers are off the model, root mean square of x and of y.
    """

    center_px: tuple[float, float]
    half_diagonal_px: float
    radial: float
    radial_sigma: float
    homography: NDArray[np.float64]
    residual_mm: float

    def to_mm(self, place_px: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return places ``(..., 2)`` on the flat skin, mm, of places ``(..., 2)`` on the image."""
        scaled = (place_px.astype(np.float64) - self.center_px) / self.half_diagonal_px
        return projected(self.homography, undistorted(scaled, self.radial))

    def document(self) -> dict[str, Any]:
        """Return it as JSON, for calibrations and tracks."""
        return {
            "center_px": list(self.center_px),
            "half_diagonal_px": self.half_diagonal_px,
            "radial": self.radial,
            "radial_sigma": self.radial_sigma,
            "homography": self.homography.tolist(),
            "residual_mm": self.residual_mm,
        }

    @classmethod
    def from_document(cls, document: Any) -> Self:
        """Build it from parsed JSON.

        Raises:
            KeyError: A key is missing.
            TypeError: A value is of another kind.
            ValueError: A value is unfit.
        """
        x, y = (float(value) for value in document["center_px"])
        numbers = {
            name: float(document[name])
            for name in ("half_diagonal_px", "radial", "radial_sigma", "residual_mm")
        }
        homography = np.array(document["homography"], np.float64)
        if homography.shape != (3, 3) or not np.isfinite([x, y, *numbers.values()]).all():
            raise ValueError("lens needs a homography of 3x3, and finite numbers")
        if not np.isfinite(homography).all() or abs(np.linalg.det(homography)) == 0.0:
            raise ValueError("lens has a homography that cannot be inverted")
        if not (numbers["half_diagonal_px"] > 0 and abs(numbers["radial"]) <= LARGEST_RADIAL):
            raise ValueError(
                f"lens: radial must lie within {LARGEST_RADIAL}, half_diagonal_px above 0"
            )
        return cls(center_px=(x, y), homography=homography, **numbers)


def undistorted(scaled: NDArray[np.float64], radial: float) -> NDArray[np.float64]:
    """Return places as a lens without distortion would show them; all relative to the centre."""
    return scaled / (1.0 + radial * (scaled**2).sum(axis=-1, keepdims=True))


def projected(homography: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places ``(..., 2)`` under a homography ``(3, 3)``."""
    moved = place @ homography[:, :2].T + homography[:, 2]
    return moved[..., :2] / moved[..., 2:]
