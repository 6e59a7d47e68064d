"""Where a deformed skin is touched, from the displacement of its markers."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.contact_patch.patch import SQUARE, Patch, patch_of_cells
from spikingtac.touch.contact_patch.patch_features import PatchFeatures
from spikingtac.touch.contact_patch.patch_model import SIDE, PatchModel, default_model
from spikingtac.touch.field.square_lattice import SquareLattice

Field = NDArray[np.float64]

LIKELY = 0.5
"""Share of the largest probability, which is near 1 in all but faint touches, above which a cell
counts as touched."""


class PatchEstimator:
    """Tells the touched part of one sensor's skin.

    Example:
        >>> estimator = PatchEstimator(calibration.reference_px)  # doctest: +SKIP
        >>> moved_px = frame.detected_px - calibration.reference_px  # doctest: +SKIP
        >>> estimator.patch(moved_px).area  # doctest: +SKIP
        4210.0
    """

    def __init__(self, reference: Field, model: PatchModel | None = None) -> None:
        """Prepare for a layout of markers.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm; their mean is taken for the middle of
                the image.
            model: What tells the touched cells; the package's unless given.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._model = model or default_model()
        self._lattice = SquareLattice.over(reference)
        self._features = PatchFeatures(self._lattice.places, np.zeros(2))
        cell = self._lattice.pitch / SIDE
        steps = np.array(list(product(np.arange(SIDE) - 0.5 * (SIDE - 1), repeat=2)))[:, ::-1]
        corners = cell * (steps[:, None] + SQUARE)
        self._corners = self._lattice.in_image(self._lattice.places[:, None, None] + corners)

    def probability(self, displacement: Field) -> Field:
        """Return how probably each cell about each point of the lattice is touched, ``(n, c)``.

        Args:
            displacement: ``(m, 2)`` of the markers from rest, in the unit of the reference, as they
                are detected: a law of hysteresis takes off what the model was fitted with.
        """
        return self._model.probability(self._features.of(self._lattice.field(displacement)))

    def patch(self, displacement: Field) -> Patch:
        """Return the touched part of a skin that is touched somewhere; see :meth:`probability`."""
        probability = self.probability(displacement)
        touched = probability > LIKELY * probability.max()
        return patch_of_cells(self._corners[touched], probability[touched])
