"""Features that give the indentation under a marker: motion and growth of its neighbourhood.

A disc grows as the image of the skin about it does, by half of the divergence. So growth alone does
not tell a skin that is spread from one that is nearer, nor does the divergence between the markers:
both hold both. But pressing spreads and lifts a bonded layer in a pattern of its own, and the discs
show its middle, which lies between the markers. The law sees the whole neighbourhood.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

REACH = 2
"""Rows and columns of neighbours on each side."""
WITHIN_PITCHES = 0.4
"""Largest distance of a neighbour from its place in a square grid, in pitches."""
DIFFERENCE_SCALE = 10.0
OWN_SCALE = 5.0
GROWTH_SCALE = 10.0
PLACE_SCALE = 3.0
NEARNESS_SCALE = 3.0
PRESENT_SCALE = 0.3
"""Factors that make all features of the order of one; the law was fitted with them."""
FEATURES = 4 * (2 * REACH + 1) ** 2 + 5
"""Number of features of a marker."""


class FieldFeatures:
    """Features of every marker of one sensor.

    Attributes:
        pitch_px: Distance between neighbours, px.
    """

    def __init__(self, reference_px: Field, size: tuple[int, int]) -> None:
        """Find the neighbourhoods.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px; the grid lies along the image's axes.
            size: ``(width, height)`` of the sensor, px: its centre is taken for the optical axis.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self.pitch_px = marker_pitch_px(reference_px)
        steps = np.array(list(product(range(-REACH, REACH + 1), repeat=2)), np.float64)[:, ::-1]
        wanted = reference_px[:, None] + steps * self.pitch_px
        away = np.hypot(*np.moveaxis(wanted[:, :, None] - reference_px, -1, 0))
        self._near = away.argmin(axis=2)
        self._there = away.min(axis=2) < WITHIN_PITCHES * self.pitch_px
        middle = (np.array(size) - 1.0) / 2.0
        self._place = (reference_px - middle) / self.pitch_px

    def of(self, displacement_px: Field, growth: Field, pitch_over_distance: float) -> Field:
        """Return the features ``(..., m, FEATURES)``.

        Args:
            displacement_px: ``(..., m, 2)`` from rest, px.
            growth: ``(..., m)`` growth of the discs' radii.
            pitch_over_distance: Pitch of the markers over the camera's distance from the skin.
        """
        moved = displacement_px / self.pitch_px
        there = self._there
        differ = (moved[..., self._near, :] - moved[..., :, None, :]) * there[..., None]
        shape = growth.shape
        parts = (
            DIFFERENCE_SCALE * differ[..., 0],
            DIFFERENCE_SCALE * differ[..., 1],
            GROWTH_SCALE * growth[..., self._near] * there,
            np.broadcast_to(PRESENT_SCALE * there, (*shape, there.shape[1])),
            OWN_SCALE * moved,
            np.broadcast_to(PLACE_SCALE * pitch_over_distance * self._place, (*shape, 2)),
            np.full((*shape, 1), NEARNESS_SCALE * pitch_over_distance),
        )
        return np.concatenate(parts, axis=-1)
