"""The touched part of the skin: its centre, area and outline, told by a small network."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.touch.field import straightened
from spikingtac.touch.network import packaged
from spikingtac.types import FloatArray

REACH = 2  # Rows and columns of neighbours on each side.
NEIGHBOURS = (2 * REACH + 1) ** 2  # Places of a neighbourhood, the marker itself included.
WITHIN_PITCHES = 0.4  # Largest distance of a neighbour from its place in a square grid, in pitches.

# Factors that make all features of the order of one; the model was fitted with them. Of the
# neighbours' displacements from the marker's, per pitch (a press makes a tenth of a pitch); of the
# marker's own; of its place; and what stands for a neighbour that is there.
DIFFERENCE_SCALE, OWN_SCALE, PLACE_SCALE, PRESENT_SCALE = 10.0, 5.0, 0.5, 0.3
FEATURES = 3 * NEIGHBOURS + 4  # Number of features of a marker.

# Cells along each side of a marker's share of the skin (0.48 mm of the twin's skin, whose own
# cells are 0.41 mm). The network was fitted to contacts on the twin, whose touched cells are known
# (``scripts/fit_patch_model.py``); it was never measured on a real skin.
SIDE = 5

# Share of the largest probability, which is near 1 in all but faint touches, above which a cell
# counts as touched.
LIKELY = 0.5

# Markers within so many pitches of a marker are its neighbours: in a square grid four, not the
# diagonal ones.
NEIGHBOUR_SHARE = 1.3

# Pitches from its place in a square grid within which a neighbour must lie.
GRID_TOLERANCE = 0.15

# Share of a square grid's neighbours that must lie so for the markers to be one.
GRID_SHARE = 0.8
LEAST_MESH_MARKERS = 4  # Markers without which there is nothing to interpolate between.

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

    place: FloatArray
    area: float
    outline: FloatArray


class PatchFeatures:
    """How the neighbourhood of every marker of one sensor has moved.

    Attributes:
        pitch_px: Distance between neighbours, px.
    """

    def __init__(self, reference_px: FloatArray, optical_axis_px: FloatArray) -> None:
        """Find the neighbourhoods.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px; the grid lies along the image's axes.
            optical_axis_px: ``(2,)`` where the optical axis meets the image, px: pressing moves
                markers away from there.

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
        self._place = (reference_px - optical_axis_px) / self.pitch_px

    def of(self, displacement_px: FloatArray) -> FloatArray:
        """Return the features ``(..., m, FEATURES)`` of displacements ``(..., m, 2)``, px.

        Where the neighbours are from the marker, along x, then along y, row by row; which of them
        are there; and where the marker itself is, from its rest and at rest.
        """
        moved, there = displacement_px / self.pitch_px, self._there
        differ = (moved[..., self._near, :] - moved[..., :, None, :]) * there[..., None]
        parts = (
            DIFFERENCE_SCALE * differ[..., 0],
            DIFFERENCE_SCALE * differ[..., 1],
            np.broadcast_to(np.where(there, PRESENT_SCALE, 0.0), (*moved.shape[:-1], NEIGHBOURS)),
            OWN_SCALE * moved,
            np.broadcast_to(PLACE_SCALE * self._place, moved.shape),
        )
        return np.concatenate(parts, axis=-1)


class SquareLattice:
    """Points of a square grid along its own axes, and how the markers' field is read there.

    Attributes:
        pitch: Mean distance between neighbouring points, in the markers' unit.
        places: ``(n, 2)`` the points along the lattice's axes, from the middle of the markers, in
            the markers' unit.
        weights: ``(n, m)`` shares of the markers in the field at each point; None where the points
            are the markers.
        rotation: ``(2, 2)`` from the lattice's axes to the image's.
    """

    def __init__(self, reference: FloatArray) -> None:
        """Lay the lattice over markers ``(m, 2)``.

        Raises:
            ConfigError: Fewer than two markers.
        """
        pitch, self._middle = marker_pitch_px(reference), reference.mean(axis=0)
        away = reference[:, None] - reference[None]
        near = away[
            (NEIGHBOUR_SHARE * pitch > np.hypot(*away.T).T) & ~np.eye(len(away), dtype=bool)
        ]
        turn = 0.25 * float(np.angle(np.exp(4j * np.arctan2(near[:, 1], near[:, 0])).mean()))
        self.rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self.places = (reference - self._middle) @ self.rotation
        steps = near @ self.rotation / pitch
        off_grid = np.abs(steps - np.round(steps)).max(axis=1)
        # A square of n markers has 4 (n - sqrt n) neighbours, each pair counted twice.
        neighbours = 4.0 * (len(reference) - np.sqrt(len(reference)))
        on_grid = (off_grid < GRID_TOLERANCE).sum() >= GRID_SHARE * neighbours
        in_a_row = len(reference) < LEAST_MESH_MARKERS or straightened(reference) is not None
        self.weights: FloatArray | None = None
        self.pitch = float(np.hypot(*near.T).mean()) if len(near) else pitch
        if not (on_grid or in_a_row):
            self.pitch, self.places, self.weights = _between(self.places)

    def field(self, values: FloatArray) -> FloatArray:
        """Return vectors ``(m, 2)`` at the markers as the lattice's points see them, ``(n, 2)``."""
        turned = values @ self.rotation
        return turned if self.weights is None else self.weights @ turned

    def in_image(self, places: FloatArray) -> FloatArray:
        """Return places ``(..., 2)`` of the lattice in the image."""
        return places @ self.rotation.T + self._middle


def _between(places: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return pitch and points of a lattice within the markers' hull, and their shares in each."""
    # A late import: every verb's start would wait for it.
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import ConvexHull, Delaunay

    mesh = Delaunay(places)
    # A mesh has two triangles for each marker, but for the border's.
    pitch = float(np.sqrt(2.0 * ConvexHull(places).volume / len(mesh.simplices)))
    low, high = places.min(axis=0), places.max(axis=0)
    axes = [np.arange(low[k], high[k] + 1e-9 * pitch, pitch) for k in range(2)]
    axes = [axis + 0.5 * (high[k] - axis[-1]) for k, axis in enumerate(axes)]
    points = np.column_stack([axis.ravel() for axis in np.meshgrid(*axes)])
    weights = LinearNDInterpolator(mesh, np.eye(len(places)))(points)
    inside = np.isfinite(weights[:, 0])
    return pitch, points[inside], weights[inside]


class PatchEstimator:
    """Tells the touched part of one sensor's skin.

    Example:
        >>> estimator = PatchEstimator(calibration.reference_px)  # doctest: +SKIP
        >>> moved_px = frame.detected_px - calibration.reference_px  # doctest: +SKIP
        >>> estimator.patch(moved_px).area  # doctest: +SKIP
        4210.0
    """

    def __init__(self, reference: FloatArray) -> None:
        """Prepare for a layout of markers.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm; their mean is taken for the middle of
                the image.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._network = packaged("patch.onnx")
        self._lattice = SquareLattice(reference)
        self._features = PatchFeatures(self._lattice.places, np.zeros(2))
        cell = self._lattice.pitch / SIDE
        steps = np.array(list(product(np.arange(SIDE) - 0.5 * (SIDE - 1), repeat=2)))[:, ::-1]
        corners = cell * (steps[:, None] + SQUARE)
        self._corners = self._lattice.in_image(self._lattice.places[:, None, None] + corners)

    def probability(self, displacement: FloatArray) -> FloatArray:
        """Return how probably each cell about each point of the lattice is touched, ``(n, c)``.

        Args:
            displacement: ``(m, 2)`` of the markers from rest, in the unit of the reference, as they
                are detected: a law of hysteresis takes off what the model was fitted with.
        """
        return self._network(self._features.of(self._lattice.field(displacement)))[0]

    def patch(self, displacement: FloatArray) -> Patch:
        """Return the touched part of a skin that is touched somewhere; see :meth:`probability`."""
        # A late import: every verb's start would wait for it.
        from scipy.spatial import ConvexHull

        probability = self.probability(displacement)
        touched = probability > LIKELY * probability.max()
        cells, weights = self._corners[touched], probability[touched]
        place = weights @ cells.mean(axis=1) / weights.sum()
        points = cells.reshape(-1, 2)
        hull = ConvexHull(points)
        return Patch(place, float(hull.volume), points[hull.vertices])  # in a plane, its area
