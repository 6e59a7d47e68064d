"""Lattices of points: the basis, the labels of the points, and a smooth model of the positions.

Points on a lattice have few different steps to their neighbours, at any angle; the two shortest
frequent steps are the basis. Labels spread outwards from one point: each cell is expected where the
labelled points around it have it, and points and cells that are mutually nearest are matched. A
smooth model of all points, with more terms the more there are, predicts missing markers.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.blobs import UNMATCHED, associate
from spikingtac.types import FloatArray

LayoutKind = Literal["auto", "grid", "staggered", "free"]

# Nearest points whose steps vote for the basis, the ring around a point of a square grid; and most
# steps that are compared.
NEIGHBOURS, MOST_STEPS = 8, 1_500

# Largest difference of two equal steps, as a share of the shorter one: the jitter of hand-made
# grids is 0.07 pitches, and lenses change the pitch by 0.1 over an image.
ALIKE = 0.2

# Least votes for a step of the basis, as a share of the votes for the most frequent step.
VOTES_SHARE = 0.5

LEAST_SINE = 0.5  # Least sine of the angle between the steps of a basis: 30 degrees.

# Cosine of the angle of the basis above which rows are staggered. Rows shifted by half a pitch have
# 0.3 to 0.5; 0.1 is a grid in perspective.
LEAST_SKEW = 0.2

# Largest distance of a point from its cell, as a share of the pitch. Spread of the weights of the
# points that predict it, in steps. (Random grids under a lens that bends the border by 5 to 40 %,
# with jitter and gaps: 497 of 525 are labelled without a mistake; with 0.33 469, with one smooth
# model of all points 359.)
REACH, SPREAD = 0.4, 1.0

AHEAD = 2  # Farthest step from a labelled point to a cell in which points are searched: one gap.

# Least number of points for each number of terms of the smooth model: affine, quadratic
# (perspective), cubic (lens distortion); four points and more per term.
MODEL_TERMS = ((0, 3), (12, 6), (40, 10))

# Weight of the basis relative to one point: it determines the pitch where a single row does not.
BASIS_WEIGHT = 0.1


@dataclass(frozen=True, slots=True)
class Lattice:
    """Labelled points, and a smooth model of their positions.

    A label counts steps of the basis; a cell is a row and a column. They differ if rows are
    staggered: then ``phase`` is the parity of the rows that are shifted to the right.

    Attributes:
        points: ``(n, 2)`` all points, px.
        index: ``(k,)`` which of them lie on the lattice.
        label: ``(k, 2)`` their labels.
        model: ``(terms, 2)`` coefficients of the smooth model.
        phase: 0 or 1 where rows are staggered, else None.
    """

    points: FloatArray
    index: NDArray[np.int64]
    label: NDArray[np.int64]
    model: FloatArray
    phase: int | None = None

    @property
    def cell(self) -> NDArray[np.int64]:
        """``(k, 2)`` row and column of each point."""
        return self._shifted(self.label, 1)

    def expected_px(self, cell: NDArray[np.int64]) -> FloatArray:
        """Return the positions of cells ``(c, 2)`` by the model, px."""
        return _terms(self._shifted(cell, -1), len(self.model)) @ self.model

    def _shifted(self, cell: NDArray[np.int64], sign: int) -> NDArray[np.int64]:
        shift = 0 if self.phase is None else (cell[:, 0] + self.phase) // 2
        return np.column_stack([cell[:, 0], cell[:, 1] + sign * shift])

    @property
    def pitch_px(self) -> float:
        """The shorter step of the model, px."""
        return float(np.hypot(*self.model[1:3].T).min())

    def occupied(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the first row and column, and which cells of the bounding window hold a point."""
        first = self.cell.min(axis=0)
        there = np.zeros(self.cell.max(axis=0) - first + 1, bool)
        there[tuple((self.cell - first).T)] = True
        return first, there


def cells_of(first: NDArray[np.int64] | tuple[int, int], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return ``(rows * columns, 2)`` the cells of a window, row-major."""
    return np.indices(shape).reshape(2, -1).T + np.asarray(first)


def find_lattice(points: FloatArray, kind: LayoutKind) -> Lattice:
    """Return the lattice of ``(n, 2)`` points that fills the smallest window of cells."""
    found = [
        replace(lattice, phase=phase)
        for basis, phases in _bases(points, kind)
        for lattice in [_labelled(points, basis)]
        for phase in phases
    ]
    return min(found, key=lambda one: one.occupied()[1].size)


def _labelled(points: FloatArray, basis: FloatArray) -> Lattice:
    from scipy.spatial import KDTree  # 0.1 s that other verbs need not wait

    # The seed is the point whose four neighbours fit the basis best.
    ways = np.array([basis[0], -basis[0], basis[1], -basis[1]])
    off = KDTree(points).query(points[:, np.newaxis] + ways)[0] / np.hypot(*ways.T)
    index, label = np.array([off.clip(max=1.0).sum(axis=1).argmin()]), np.zeros((1, 2), np.int64)
    reach_px, ahead = REACH * np.hypot(*basis.T).min(), 1
    while ahead <= AHEAD:
        low, high = label.min(axis=0) - ahead, label.max(axis=0) + ahead
        cell = cells_of(low, tuple(high - low + 1))
        cell = cell[KDTree(label).query(cell, p=np.inf)[0] <= ahead]
        match = associate(_predicted_px(cell, label, points[index], basis), points, reach_px)
        seen = match != UNMATCHED
        grows = np.count_nonzero(seen) > len(index)
        index, label = (match[seen], cell[seen]) if grows else (index, label)
        ahead = 1 if grows else ahead + 1
    terms = max(count for needed, count in MODEL_TERMS if len(index) >= needed)
    design = np.vstack([_terms(label, terms), BASIS_WEIGHT * np.eye(2, terms, 1)])
    places_px = np.vstack([points[index], BASIS_WEIGHT * basis])
    model = np.asarray(np.linalg.lstsq(design, places_px, rcond=None)[0], np.float64)
    return Lattice(points, index, label, model)


def _predicted_px(
    cell: NDArray[np.int64], label: NDArray[np.int64], places_px: FloatArray, basis: FloatArray
) -> FloatArray:
    # Places of cells by an affine fit for each, in which near points weigh most: a lens bends rows.
    from scipy.spatial.distance import cdist

    weight = np.exp(-0.5 * (cdist(cell, label) / SPREAD) ** 2)
    design, known = _terms(label, 3), BASIS_WEIGHT**2 * np.diag([0.0, 1.0, 1.0])
    normal = np.einsum("ck,ki,kj->cij", weight, design, design) + known
    right = np.einsum("ck,ki,kd->cid", weight, design, places_px) + known[:, 1:] @ basis
    return np.einsum("ci,cid->cd", _terms(cell, 3), np.linalg.solve(normal, right))


def _bases(points: FloatArray, kind: LayoutKind) -> list[tuple[FloatArray, tuple[int | None, ...]]]:
    # Bases, steps to the next column and row, px, as (2, 2), and phases to try.
    first, second = _shortest_steps(points)
    cosine = abs(first @ second) / (np.hypot(*first) * np.hypot(*second))
    if kind == "staggered" or (kind == "auto" and cosine > LEAST_SKEW):
        return [(basis, (0, 1)) for basis in _staggered_bases(first, second)]
    across, down = sorted((first, second), key=lambda step: -abs(step[0]) / np.hypot(*step))
    return [(np.array([across * np.sign(across[0] or 1), down * np.sign(down[1] or 1)]), (None,))]


def _staggered_bases(first: FloatArray, second: FloatArray) -> list[FloatArray]:
    # A step along the row, and a step of half a pitch to the next row. Hexagonal lattices have rows
    # in three directions; the most level ones come first.
    found = []
    for along, other in (
        (first, second), (second, first), (first + second, first), (first - second, first)
    ):  # fmt: skip
        row = along * np.sign(along[0] if abs(along[0]) > 1e-3 * abs(along[1]) else along[1])
        step = other * np.sign(other @ np.array([-row[1], row[0]]))
        share = float(step @ row / (row @ row))
        off_half = abs(share % 1.0 - 0.5)
        basis = np.array([row, step - np.floor(share) * row])
        found.append((off_half > 0.5 * ALIKE, abs(row[1]) / np.hypot(*row), off_half, basis))
    found.sort(key=lambda one: one[:3])
    return [one[3] for one in found if not one[0]] or [found[0][3]]


def _shortest_steps(
    points: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    # The two shortest frequent steps between neighbours.
    from scipy.spatial import KDTree

    near = np.asarray(KDTree(points).query(points, min(NEIGHBOURS, len(points) - 1) + 1)[1])
    steps = (points[near[:, 1:]] - points[:, np.newaxis]).reshape(-1, 2)
    steps = steps[:: -(-len(steps) // MOST_STEPS)]
    first = _frequent_step(steps)
    sine = np.abs(first[0] * steps[:, 1] - first[1] * steps[:, 0])
    aside = sine > LEAST_SINE * np.hypot(*first) * np.hypot(*steps.T)
    second = _frequent_step(steps[aside]) if aside.any() else np.array([-first[1], first[0]])
    return first, second


def _frequent_step(steps: FloatArray) -> FloatArray:
    # The shortest frequent step: the median of the steps equal to it, up to sign.
    length = np.hypot(*steps.T)
    both = np.stack([steps, -steps])[:, :, np.newaxis]
    apart = np.linalg.norm(both - steps, axis=3).min(axis=0)
    alike = apart < ALIKE * np.minimum(length[:, np.newaxis], length)
    votes = alike.sum(axis=1)
    best = int(np.where(votes >= VOTES_SHARE * votes.max(), length, np.inf).argmin())
    like = steps[alike[best]]
    return np.median(like * np.sign(like @ steps[best])[:, np.newaxis], axis=0)


def _terms(label: NDArray[np.int64], terms: int) -> FloatArray:
    row, column = label.astype(np.float64).T
    columns = [np.ones(len(row)), column, row, row * column, row**2, column**2]
    columns += [row**3, row**2 * column, row * column**2, column**3]
    return np.column_stack(columns[:terms])
