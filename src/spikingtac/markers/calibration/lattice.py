"""Lattices of points: the basis, the labels of the points, and a smooth model through them.

Points on a lattice have few different steps to their neighbours, at any angle; the two shortest
that repeat are its basis. Labels grow from point to point with a local basis, so that perspective
and barrel distortion need no model; a smooth model over all labels then throws out what does not
fit and says where a missing marker should be.
"""

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

LayoutKind = Literal["auto", "grid", "staggered", "free"]

# Nearest points whose steps vote for the basis: the ring around a point of a square grid. So many
# steps are compared at most.
NEIGHBOURS, MOST_STEPS = 8, 1_500

# Two steps are alike up to this share of the shorter one: the jitter of hand-made grids is 0.07
# pitches, and lenses change the pitch by 0.1 over an image.
ALIKE = 0.2

# A step of the basis has at least this share of the votes of the most frequent step.
VOTES_SHARE = 0.5

LEAST_SINE = 0.5  # Sine of the angle between two steps from which they span a lattice: 30 degrees.

# Cosine of the angle of the reduced basis from which rows are staggered. Rows that are shifted by
# half a pitch have 0.3 to 0.5; 0.1 is a grid in perspective.
LEAST_SKEW = 0.2

# How far a point may lie from where its neighbour expects it, as a share of the pitch.
REACH = 0.33

# Points from which the smooth model gets so many terms: affine, quadratic (perspective), cubic
# (lens distortion); four points and more for each term.
MODEL_TERMS = ((0, 3), (12, 6), (40, 10))

Label = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Lattice:
    """Labelled points and the smooth model through them.

    A label counts steps of the basis; a cell is a row and a column. They differ where rows are
    staggered: there ``phase`` says which rows are shifted to the right.
    """

    points: NDArray[np.float64]
    labels: dict[int, Label]
    model: NDArray[np.float64]
    phase: int | None = None

    def cells(self) -> dict[int, Label]:
        """Return the cell of each labelled point."""
        return {index: self._moved(label, 1) for index, label in self.labels.items()}

    def expected_px(self, cells: list[Label]) -> NDArray[np.float64]:
        """Return where the model has some cells, px."""
        return _terms([self._moved(cell, -1) for cell in cells], len(self.model)) @ self.model

    def _moved(self, cell: Label, way: int) -> Label:
        shift = 0 if self.phase is None else (cell[0] + self.phase) // 2
        return cell[0], cell[1] + way * shift

    @property
    def pitch_px(self) -> float:
        """The shorter step of the model, px."""
        return min(float(np.hypot(*self.model[axis])) or np.inf for axis in (1, 2))

    def there(self) -> tuple[Label, NDArray[np.bool_]]:
        """Return the first row and column, and which cells of the bounding window have a point."""
        cells = np.array(list(self.cells().values()))
        low, high = cells.min(axis=0), cells.max(axis=0)
        there = np.zeros(high - low + 1, bool)
        there[tuple((cells - low).T)] = True
        return (int(low[0]), int(low[1])), there


def expected_places(
    position_px: NDArray[np.float64], known: NDArray[np.bool_], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Return where a smooth grid through the known markers has every marker, px.

    Of the affine, the quadratic and the cubic grid the one is taken that expects each known marker
    best from the others.

    Args:
        position_px: ``(rows * columns, 2)`` places, row-major.
        known: ``bool[rows * columns]`` which of them are known; three at least.
        shape: ``(rows, columns)``.
    """
    cells = list(itertools.product(range(shape[0]), range(shape[1])))
    best, expected = np.inf, position_px
    for _, count in MODEL_TERMS:
        terms = _terms(cells, count)
        if known.sum() <= count and count > MODEL_TERMS[0][1]:
            continue
        inverse = np.linalg.pinv(terms[known])
        places = terms @ inverse @ position_px[known]
        # Leaving a point out divides its residual by what the others leave of its weight.
        others = np.maximum(1.0 - (terms[known] * inverse.T).sum(axis=1), 1e-6)
        off = float((((position_px - places)[known] / others[:, np.newaxis]) ** 2).mean())
        if off < best:
            best, expected = off, places
    return expected


def labelled(
    points: NDArray[np.float64], basis: NDArray[np.float64], phases: tuple[int | None, ...]
) -> list[Lattice]:
    """Label all points that lie on the lattice of a basis; return it for each phase."""
    lattice = _cleaned(points, _grown(points, basis))
    while len(more := _adopted(lattice)) > len(lattice.labels):
        before, lattice = lattice, _cleaned(points, more)
        if len(lattice.labels) <= len(before.labels):
            break
    return [replace(lattice, phase=phase) for phase in phases]


def bases(
    points: NDArray[np.float64], kind: LayoutKind
) -> list[tuple[NDArray[np.float64], tuple[int | None, ...]]]:
    """Return bases, steps to the next column and row, px, as (2, 2), and phases to try."""
    if len(points) == 1:
        return [(1e6 * np.eye(2), (None,))]  # any pitch that reaches nothing else
    first, second = _reduced(*_shortest_steps(points))
    cosine = abs(first @ second) / (np.hypot(*first) * np.hypot(*second))
    if kind == "staggered" or (kind == "auto" and cosine > LEAST_SKEW):
        return [(basis, (0, 1)) for basis in _staggered_bases(first, second)]
    across, down = sorted((first, second), key=lambda step: -abs(step[0]) / np.hypot(*step))
    return [(np.array([across * np.sign(across[0] or 1), down * np.sign(down[1] or 1)]), (None,))]


def _staggered_bases(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    # Along rows, and half a pitch on to the next row: hexagons have rows in three directions. The
    # most level rows come first.
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
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # The two shortest steps between neighbours that many pairs of neighbours share.
    from scipy.spatial import KDTree  # 0.1 s that other verbs need not wait

    near = np.asarray(KDTree(points).query(points, min(NEIGHBOURS, len(points) - 1) + 1)[1])
    steps = (points[near[:, 1:]] - points[:, np.newaxis]).reshape(-1, 2)
    steps = steps[:: -(-len(steps) // MOST_STEPS)]
    first = _voted(steps, np.ones(len(steps), bool))
    sine = np.abs(first[0] * steps[:, 1] - first[1] * steps[:, 0])
    aside = sine > LEAST_SINE * np.hypot(*first) * np.hypot(*steps.T)
    second = _voted(steps, aside) if aside.any() else np.array([-first[1], first[0]])
    return first, second


def _voted(steps: NDArray[np.float64], may: NDArray[np.bool_]) -> NDArray[np.float64]:
    # The shortest of the frequent steps, as the median of those like it, to either side.
    chosen = steps[may]
    length = np.hypot(*chosen.T)
    apart = np.minimum(
        np.hypot(*(chosen[:, np.newaxis] - chosen).transpose(2, 0, 1)),
        np.hypot(*(chosen[:, np.newaxis] + chosen).transpose(2, 0, 1)),
    )
    alike = apart < ALIKE * np.minimum(length[:, np.newaxis], length)
    votes = alike.sum(axis=1)
    best = int(np.where(votes >= VOTES_SHARE * votes.max(), length, np.inf).argmin())
    like = chosen[alike[best]]
    return np.median(like * np.sign(like @ chosen[best])[:, np.newaxis], axis=0)


def _reduced(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Lagrange's reduction: the two shortest steps of the lattice.
    while True:
        if second @ second < first @ first:
            first, second = second, first
        turns = np.round(first @ second / (first @ first))
        if turns == 0.0:
            return first, second
        second = second - turns * first


def _grown(points: NDArray[np.float64], basis: NDArray[np.float64]) -> dict[int, Label]:
    labels: dict[int, Label] = {}
    taken: set[Label] = set()
    turn = itertools.count()  # unique, so that the heap never compares what comes after it
    queue = [(0, 0.0, next(turn), _seed(points, basis), (0, 0), basis)]
    while queue:
        skipped, _, _, index, label, local = heapq.heappop(queue)
        if index in labels or label in taken:
            continue
        labels[index] = label
        taken.add(label)
        for stride, off, other, cell, pitch in _followers(points, index, label, local):
            if other not in labels and cell not in taken:
                key = (skipped + stride - 1, off, next(turn))
                heapq.heappush(queue, (*key, other, cell, pitch))
    return labels


def _followers(
    points: NDArray[np.float64], index: int, label: Label, local: NDArray[np.float64]
) -> Iterator[tuple[int, float, int, Label, NDArray[np.float64]]]:
    # One column or row on, in either sense; where nothing is there, over one gap.
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        length = float(np.hypot(*local[axis]))
        for stride in (1, 2):
            expected = points[index] + sign * stride * local[axis]
            off = np.hypot(*(points - expected).T)
            other = int(off.argmin())
            if off[other] > REACH * length:
                continue
            pitch = np.array(local)
            pitch[axis] = 0.5 * pitch[axis] + 0.5 * sign * (points[other] - points[index]) / stride
            ahead = sign * stride
            cell = (label[0] + ahead, label[1]) if axis else (label[0], label[1] + ahead)
            yield stride, float(off[other]), other, cell, pitch
            break


def _seed(points: NDArray[np.float64], basis: NDArray[np.float64]) -> int:
    # The point whose four neighbours fit the mean pitch best.
    cost = np.zeros(len(points))
    for step in (basis[0], -basis[0], basis[1], -basis[1]):
        ahead = points + step
        off = np.hypot(*(points[np.newaxis] - ahead[:, np.newaxis]).transpose(2, 0, 1)).min(axis=1)
        cost += np.minimum(off / np.hypot(*step), 1.0)
    return int(cost.argmin())


def _terms(labels: list[Label], terms: int) -> NDArray[np.float64]:
    row, column = np.array(labels, float).reshape(-1, 2).T
    columns = [np.ones(len(row)), column, row, row * column, row**2, column**2]
    columns += [row**3, row**2 * column, row * column**2, column**3]
    return np.column_stack(columns[:terms])


def _cleaned(points: NDArray[np.float64], labels: dict[int, Label]) -> Lattice:
    # Fit the smooth model; throw out the worst point while it is off by more than REACH.
    labels = dict(labels)
    while True:
        terms = max(count for points_needed, count in MODEL_TERMS if len(labels) >= points_needed)
        index, cells = list(labels), list(labels.values())
        design = _terms(cells, terms)
        model = np.asarray(np.linalg.lstsq(design, points[index], rcond=None)[0], np.float64)
        lattice = Lattice(points, labels, model)
        off = np.hypot(*(points[index] - design @ model).T)
        if off.max() <= REACH * lattice.pitch_px or len(labels) < 4:
            return lattice
        del labels[index[int(off.argmax())]]


def _adopted(lattice: Lattice) -> dict[int, Label]:
    # Points that no neighbour reached, but that lie where the model has a marker, one row or column
    # beyond the known ones included.
    points, labels = lattice.points, lattice.labels
    cells = np.array(list(labels.values()))
    low, high = cells.min(axis=0) - 1, cells.max(axis=0) + 1
    span = [(i, j) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)]
    free = [cell for cell in span if cell not in set(labels.values())]
    expected, adopted = lattice.expected_px(free), dict(labels)
    for index in set(range(len(points))) - set(labels):
        off = np.hypot(*(expected - points[index]).T)
        nearest = int(off.argmin())
        if off[nearest] <= REACH * lattice.pitch_px and free[nearest] not in adopted.values():
            adopted[index] = free[nearest]
    return adopted
