"""What a patch model looks at: the motion of a marker's neighbourhood, and where it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.neighbourhoods import MOTION_FEATURES, Neighbourhoods

Field = NDArray[np.float64]

PLACE_SCALE = 0.5
"""Factor that makes places of the order of one; the model was fitted with it."""
FEATURES = MOTION_FEATURES + 2
"""Number of features of a marker."""


class PatchFeatures:
    """Features of every marker of one sensor.

    Attributes:
        pitch_px: Distance between neighbours, px.
    """

    def __init__(self, reference_px: Field, optical_axis_px: Field) -> None:
        """Find the neighbourhoods.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px; the grid lies along the image's axes.
            optical_axis_px: ``(2,)`` where the optical axis meets the image, px: pressing moves
                markers away from there.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._neighbourhoods = Neighbourhoods(reference_px, optical_axis_px)
        self.pitch_px = self._neighbourhoods.pitch_px

    def of(self, displacement_px: Field) -> Field:
        """Return the features ``(..., m, FEATURES)`` of displacements ``(..., m, 2)``, px."""
        motion = self._neighbourhoods.motion(displacement_px)
        place = np.broadcast_to(PLACE_SCALE * self._neighbourhoods.place, displacement_px.shape)
        return np.concatenate([motion, place], axis=-1)
