"""Features that give the indentation under a marker: motion and growth of its neighbourhood.

A disc grows as the image of the skin about it does, by half of the divergence. So growth alone does
not tell a skin that is spread from one that is nearer, nor does the divergence between the markers:
both hold both. But pressing spreads and lifts a bonded layer in a pattern of its own, and the discs
show its middle, which lies between the markers. The law sees the whole neighbourhood.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.field.neighbourhoods import MOTION_FEATURES, NEIGHBOURS, Neighbourhoods

Field = NDArray[np.float64]

GROWTH_SCALE = 10.0
PLACE_SCALE = 3.0
NEARNESS_SCALE = 3.0
"""Factors that make all features of the order of one; the law was fitted with them."""
FEATURES = MOTION_FEATURES + NEIGHBOURS + 3
"""Number of features of a marker."""


class FieldFeatures:
    """Features of every marker of one sensor.

    Attributes:
        pitch_px: Distance between neighbours, px.
    """

    def __init__(self, reference_px: Field, optical_axis_px: Field) -> None:
        """Find the neighbourhoods.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px; the grid lies along the image's axes.
            optical_axis_px: ``(2,)`` where the optical axis meets the image, px.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._neighbourhoods = Neighbourhoods(reference_px, optical_axis_px)
        self.pitch_px = self._neighbourhoods.pitch_px

    def of(self, displacement_px: Field, growth: Field, pitch_over_distance: float) -> Field:
        """Return the features ``(..., m, FEATURES)``.

        Args:
            displacement_px: ``(..., m, 2)`` from rest, px.
            growth: ``(..., m)`` growth of the discs' radii.
            pitch_over_distance: Pitch of the markers over the camera's distance from the skin.
        """
        place = PLACE_SCALE * pitch_over_distance * self._neighbourhoods.place
        parts = (
            self._neighbourhoods.motion(displacement_px),
            GROWTH_SCALE * self._neighbourhoods.around(growth),
            np.broadcast_to(place, (*growth.shape, 2)),
            np.full((*growth.shape, 1), NEARNESS_SCALE * pitch_over_distance),
        )
        return np.concatenate(parts, axis=-1)
