"""Find the grid in a cloud of points: rows, columns, missing markers and points that are none.

Labels grow from point to point with a local pitch, so that rotation (to about 20 degrees),
perspective and barrel distortion need no model; a smooth model over all labels then throws out what
does not fit and says where a missing marker should be. Ours; the paper has 8x8 and does not say how
its markers are told apart.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError

CONE = 0.5
"""Tangent of the half angle in which a row's next point is sought: 27 degrees, so that at 15
degrees of rotation rows are inside and diagonals (30 degrees) outside."""

REACH = 0.33
"""How far a point may lie from where its neighbour expects it, as a share of the pitch."""

FEWEST_SHARE = 1 / 3
"""A border row or column with a smaller share of its markers is taken for stray points."""

MODEL_TERMS = ((0, 3), (12, 6), (40, 10))
"""Points from which the smooth model gets so many terms: affine, quadratic (perspective), cubic
(lens distortion); four points and more for each term."""

ABSENT = -1

Label = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid found in points.

    Attributes:
        shape: ``(rows, columns)``.
        point: ``int64[rows * columns]`` index of each marker's point, row-major, or ABSENT.
        expected_px: ``(rows * columns, 2)`` where the smooth model has each marker, px.
        stray: Indices of points that belong to no marker.
    """

    shape: tuple[int, int]
    point: NDArray[np.int64]
    expected_px: NDArray[np.float64]
    stray: list[int] = field(default_factory=list)

    @property
    def missing(self) -> NDArray[np.int64]:
        """Indices of the markers without a point."""
        return np.flatnonzero(self.point == ABSENT)


def find_grid(
    points_px: NDArray[np.float64], size: tuple[int, int], shape: tuple[int, int] | None = None
) -> Grid:
    """Sort points into a grid.

    Args:
        points_px: ``(n, 2)`` candidates, px.
        size: ``(width, height)``; whole rows out of sight are not missed.
        shape: ``(rows, columns)`` where it is known; None finds it.

    Raises:
        CalibrationError: There is no point, or a grid of ``shape`` does not fit.

    Example:
        >>> import numpy as np
        >>> points = np.array([[30.0, 30], [10, 10], [30, 10], [10, 30], [50, 30], [50, 10]])
        >>> grid = find_grid(points, (60, 40))
        >>> grid.shape, grid.point.tolist()
        ((2, 3), [1, 2, 5, 3, 0, 4])
    """
    points = np.asarray(points_px, np.float64)
    if len(points) == 0:
        raise CalibrationError("no candidate for a marker was found")
    labels = _grown(points, _basis(points))
    labels, model = _cleaned(points, labels)
    labels, model = _cleaned(points, _adopted(points, labels, model))
    (row, column), (rows, columns) = _window(labels, model, size, shape)
    point = np.full(rows * columns, ABSENT, np.int64)
    for index, (i, j) in labels.items():
        if 0 <= i - row < rows and 0 <= j - column < columns:
            point[(i - row) * columns + j - column] = index
    cells = [(row + i, column + j) for i in range(rows) for j in range(columns)]
    used = set(point.tolist())
    stray = [index for index in range(len(points)) if index not in used]
    return Grid((rows, columns), point, _terms(cells, model.shape[0]) @ model, stray)


def _basis(points: NDArray[np.float64]) -> NDArray[np.float64]:
    # Steps to the next column and to the next row, px, as (2, 2): medians over nearest points.
    step = points[np.newaxis] - points[:, np.newaxis]
    found = [_nearest(step[..., axis], step[..., 1 - axis], step) for axis in (0, 1)]
    across, down = found
    if across is None and down is None:
        return 1e6 * np.eye(2)  # one point alone: any pitch that reaches nothing else
    if across is None and down is not None:
        across = np.array([down[1], -down[0]])
    if down is None and across is not None:
        down = np.array([-across[1], across[0]])
    return np.array([across, down])


def _nearest(
    along: NDArray[np.float64], aside: NDArray[np.float64], step: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    distance = np.where(
        (along > 0) & (np.abs(aside) <= CONE * along), np.hypot(along, aside), np.inf
    )
    chosen = distance.argmin(axis=1)
    rows = np.flatnonzero(np.isfinite(distance.min(axis=1)))
    return np.median(step[rows, chosen[rows]], axis=0) if len(rows) else None


def _grown(points: NDArray[np.float64], basis: NDArray[np.float64]) -> dict[int, Label]:
    seed = _seed(points, basis)
    labels: dict[int, Label] = {}
    taken: set[Label] = set()
    turn = itertools.count()  # unique, so that the heap never compares what comes after it
    queue = [(0, 0.0, next(turn), seed, (0, 0), basis)]
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


def _terms(labels: list[Label], terms: int) -> NDArray[np.float64]:
    row, column = np.array(labels, float).T
    columns = [np.ones(len(row)), column, row, row * column, row**2, column**2]
    columns += [row**3, row**2 * column, row * column**2, column**3]
    return np.column_stack(columns[:terms])


def _cleaned(
    points: NDArray[np.float64], labels: dict[int, Label]
) -> tuple[dict[int, Label], NDArray[np.float64]]:
    # Fit the smooth model; throw out the worst point while it is off by more than REACH.
    labels = dict(labels)
    while True:
        terms = max(count for points_needed, count in MODEL_TERMS if len(labels) >= points_needed)
        index, cells = list(labels), list(labels.values())
        design = _terms(cells, terms)
        model = np.asarray(np.linalg.lstsq(design, points[index], rcond=None)[0], np.float64)
        off = np.hypot(*(points[index] - design @ model).T)
        pitch = min(float(np.hypot(*model[axis])) or np.inf for axis in (1, 2))
        if off.max() <= REACH * pitch or len(labels) < 4:
            return labels, model
        del labels[index[int(off.argmax())]]


def _adopted(
    points: NDArray[np.float64], labels: dict[int, Label], model: NDArray[np.float64]
) -> dict[int, Label]:
    # Points that no neighbour reached, but that lie where the model has a marker, one row or column
    # beyond the known ones included.
    cells = np.array(list(labels.values()))
    low, high = cells.min(axis=0) - 1, cells.max(axis=0) + 1
    span = [(i, j) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)]
    free = [cell for cell in span if cell not in set(labels.values())]
    expected = _terms(free, len(model)) @ model
    pitch = min(float(np.hypot(*model[axis])) or np.inf for axis in (1, 2))
    adopted = dict(labels)
    for index in set(range(len(points))) - set(labels):
        off = np.hypot(*(expected - points[index]).T)
        nearest = int(off.argmin())
        if off[nearest] <= REACH * pitch and free[nearest] not in adopted.values():
            adopted[index] = free[nearest]
    return adopted


def _window(
    labels: dict[int, Label],
    model: NDArray[np.float64],
    size: tuple[int, int],
    shape: tuple[int, int] | None,
) -> tuple[Label, tuple[int, int]]:
    cells = np.array(list(labels.values()))
    low, high = cells.min(axis=0), cells.max(axis=0)
    there = np.zeros(high - low + 1, bool)
    there[tuple((cells - low).T)] = True
    if shape is not None:
        first = _best_placed(there, shape)
        return (int(low[0]) + first[0], int(low[1]) + first[1]), shape
    every = [(i, j) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)]
    expected = _terms(every, len(model)) @ model
    outside = (expected < 0) | (expected > np.array(size) - 1)
    hidden = np.asarray(outside.any(axis=1)).reshape(there.shape)
    first, last = _trimmed(there, hidden)
    return (
        (int(low[0]) + first[0], int(low[1]) + first[1]),
        (last[0] - first[0], last[1] - first[1]),
    )


def _best_placed(there: NDArray[np.bool_], shape: tuple[int, int]) -> Label:
    rows, columns = shape
    padded = np.pad(there, ((rows - 1, rows - 1), (columns - 1, columns - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, shape).sum(axis=(2, 3))
    first = np.unravel_index(int(windows.argmax()), windows.shape)
    return int(first[0]) - rows + 1, int(first[1]) - columns + 1


def _trimmed(
    there: NDArray[np.bool_], hidden: NDArray[np.bool_]
) -> tuple[tuple[int, int], tuple[int, int]]:
    # Take off border lines that are nearly empty, or whose gaps all lie out of sight.
    first, last = [0, 0], list(there.shape)
    trimming = True
    while trimming:
        trimming = False
        for axis in (0, 1):
            for side in (0, 1):
                span = [slice(first[0], last[0]), slice(first[1], last[1])]
                line = last[axis] - 1 if side else first[axis]
                span[axis] = slice(line, line + 1)
                found, unseen = there[tuple(span)].ravel(), hidden[tuple(span)].ravel()
                lost = not found.all() and unseen[~found].all()
                if last[axis] - first[axis] > 1 and (found.mean() < FEWEST_SHARE or lost):
                    first[axis], last[axis] = first[axis] + (1 - side), last[axis] - side
                    trimming = True
    return (first[0], first[1]), (last[0], last[1])
