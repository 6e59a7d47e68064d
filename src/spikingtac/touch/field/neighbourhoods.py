"""What surrounds each marker of a square grid: the markers two rows and columns about it."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

REACH = 2
"""Rows and columns of neighbours on each side."""
NEIGHBOURS = (2 * REACH + 1) ** 2
"""Places of a neighbourhood, the marker itself included."""
WITHIN_PITCHES = 0.4
"""Largest distance of a neighbour from its place in a square grid, in pitches."""
DIFFERENCE_SCALE = 10.0
"""Factor of the neighbours' displacements from the marker's, per pitch: a press makes a tenth of a
pitch. It and the next two make all features of the order of one (ours); laws are fitted with
them."""
OWN_SCALE = 5.0
"""Factor of the marker's own displacement, per pitch."""
PRESENT_SCALE = 0.3
"""What stands for a neighbour that is there; 0 for none."""
MOTION_FEATURES = 3 * NEIGHBOURS + 2
"""Number of features of a marker's neighbourhood in motion."""


class Neighbourhoods:
    """The neighbourhoods of one sensor.

    Attributes:
        pitch_px: Distance between neighbours, px.
        place: ``(m, 2)`` of the markers from the optical axis, in pitches.
    """

    def __init__(self, reference_px: Field, optical_axis_px: Field) -> None:
        """Find the neighbours.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px; the grid lies along the image's axes.
            optical_axis_px: ``(2,)`` where the optical axis meets the image, px.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self.pitch_px = marker_pitch_px(reference_px)
        steps = np.array(list(product(range(-REACH, REACH + 1), repeat=2)), np.float64)[:, ::-1]
        shape = len(reference_px), NEIGHBOURS
        self._near, self._there = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
        # Step by step: all at once would take half a gigabyte for a thousand markers.
        for k, step in enumerate(steps * self.pitch_px):
            aside = reference_px[:, None] + step - reference_px
            away = np.hypot(aside[..., 0], aside[..., 1])
            self._near[:, k] = away.argmin(axis=1)
            self._there[:, k] = away.min(axis=1) < WITHIN_PITCHES * self.pitch_px
        self.place = (reference_px - optical_axis_px) / self.pitch_px

    def motion(self, displacement_px: Field) -> Field:
        """Return how each neighbourhood has moved, ``(..., m, MOTION_FEATURES)``.

        Where the neighbours are from the marker, along x, then along y, row by row; which of them
        are there; and where the marker itself is.

        Args:
            displacement_px: ``(..., m, 2)`` from rest, px.
        """
        moved, there = displacement_px / self.pitch_px, self._there
        differ = (moved[..., self._near, :] - moved[..., :, None, :]) * there[..., None]
        parts = (
            DIFFERENCE_SCALE * differ[..., 0],
            DIFFERENCE_SCALE * differ[..., 1],
            np.broadcast_to(np.where(there, PRESENT_SCALE, 0.0), (*moved.shape[:-1], NEIGHBOURS)),
            OWN_SCALE * moved,
        )
        return np.concatenate(parts, axis=-1)

    def around(self, values: Field) -> Field:
        """Return the values ``(..., m, NEIGHBOURS)`` of all neighbours; 0 where there is none.

        Args:
            values: ``(..., m)`` of the markers.
        """
        return values[..., self._near] * self._there
