"""The touched part of the skin: its centre, area and outline, told by a small network."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.layout import MOTION_FEATURES, Neighbourhoods, SquareLattice
from spikingtac.touch.network import packaged

Field = NDArray[np.float64]


# Corners of a square about its centre, in its sides.
SQUARE = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


@dataclass(frozen=True, slots=True)
class Patch:
    """A touched part of the skin, in the markers' unit.

    Attributes:
        place: ``(2,)`` its centre.
        area: Area within its outline.
        outline: ``(k, 2)`` its convex outline.
    """

    place: Field
    area: float
    outline: Field


def patch_of_cells(corners: Field, weights: Field) -> Patch:
    """Return the patch that cells make up.

    Args:
        corners: ``(c, 4, 2)`` corners of each cell; at least one cell.
        weights: ``(c,)`` how surely each is touched; they weigh the centre.
    """
    # A late import: every verb's start would wait for it.
    from scipy.spatial import ConvexHull

    points = corners.reshape(-1, 2)
    hull = ConvexHull(points)
    place = weights @ corners.mean(axis=1) / weights.sum()
    return Patch(place, float(hull.volume), points[hull.vertices])  # in a plane, its area


PLACE_SCALE = 0.5  # Factor that makes places of the order of one; the model was fitted with it.
FEATURES = MOTION_FEATURES + 2  # Number of features of a marker.


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


# Cells along each side of a marker's share of the skin (ours: 0.48 mm of the twin's skin, whose
# own cells are 0.41 mm). The network was fitted to contacts on the twin, whose touched cells are
# known (``scripts/fit_patch_model.py``); it was never measured on a real skin.
SIDE = 5

# Share of the largest probability, which is near 1 in all but faint touches, above which a cell
# counts as touched.
LIKELY = 0.5


class PatchEstimator:
    """Tells the touched part of one sensor's skin.

    Example:
        >>> estimator = PatchEstimator(calibration.reference_px)  # doctest: +SKIP
        >>> moved_px = frame.detected_px - calibration.reference_px  # doctest: +SKIP
        >>> estimator.patch(moved_px).area  # doctest: +SKIP
        4210.0
    """

    def __init__(self, reference: Field) -> None:
        """Prepare for a layout of markers.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm; their mean is taken for the middle of
                the image.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._network = packaged("patch.onnx")
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
        return self._network(self._features.of(self._lattice.field(displacement)))[0]

    def patch(self, displacement: Field) -> Patch:
        """Return the touched part of a skin that is touched somewhere; see :meth:`probability`."""
        probability = self.probability(displacement)
        touched = probability > LIKELY * probability.max()
        return patch_of_cells(self._corners[touched], probability[touched])
