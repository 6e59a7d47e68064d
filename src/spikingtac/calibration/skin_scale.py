"""From pixels to millimetres on the skin: by one scale, or by what is known of the lens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.lens import Lens

HALF_STEP_PX = 0.5
"""Half the distance of the places from which a local scale is taken."""


@dataclass(frozen=True, slots=True)
class SkinScale:
    """Places on the image as places on the flat skin.

    Attributes:
        px_per_mm: The mean scale.
        lens: Where each pixel looks, or None: the mean scale stands for all of them.
    """

    px_per_mm: float
    lens: Lens | None = None

    @classmethod
    def of(cls, px_per_mm: float | None, lens: Any) -> Self | None:
        """Return the scale of a file that may know none, its lens as parsed JSON or None.

        Raises:
            KeyError, TypeError, ValueError: The lens is damaged.
        """
        known = None if lens is None else Lens.from_document(lens)
        return None if px_per_mm is None else cls(px_per_mm, known)

    def to_mm(self, place_px: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return places ``(..., 2)`` of the skin, mm, of places ``(..., 2)`` of the image.

        The axes are those of the image. With a lens, the image's centre is where the mean scale
        has it.
        """
        if self.lens is None:
            return place_px / np.float64(self.px_per_mm)
        center_px = np.array(self.lens.center_px)
        away_mm = self.lens.to_mm(place_px) - self.lens.to_mm(center_px)
        return away_mm + center_px / self.px_per_mm

    def mm_per_px(self, place_px: NDArray[np.floating]) -> float:
        """Return the scale at one place ``(2,)``: the square root of what a square pixel covers."""
        if self.lens is None:
            return 1.0 / self.px_per_mm
        steps_px = np.array([[-HALF_STEP_PX, 0.0], [HALF_STEP_PX, 0.0]])
        x, y = (
            np.diff(self.lens.to_mm(place_px + way), axis=0)[0]
            for way in (steps_px, steps_px[:, ::-1])
        )
        return float(np.sqrt(abs(x[0] * y[1] - x[1] * y[0]))) / (2.0 * HALF_STEP_PX)
