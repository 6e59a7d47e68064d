"""Find the layout in a cloud of points: rows and columns, staggered rows, or neighbours alone.

The paper has 8x8 and does not say how its markers are told apart.
"""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.lattice import Label, Lattice, LayoutKind, bases, labelled

# So near to its place, as a share of the pitch, a point beyond a nearly empty border line is a
# marker; of points anywhere within REACH one in eight is.
ON_LATTICE = 0.12

# Slope of the rows, 3 degrees, up to which a grid is taken for a rectangle along the image: a
# corner without a marker has lost it. Beyond, the image may cut the corners of the grid off.
LEVEL_SLOPE = 0.05

# A border row or column with a smaller share of its markers is taken for stray points.
FEWEST_SHARE = 1 / 3


ABSENT = -1

Bounds = tuple[Label, Label]


@dataclass(frozen=True, slots=True)
class Layout:
    """Which point is which marker.

    Attributes:
        shape: ``(rows, columns)``, or None where the markers do not fill rows.
        point: ``int64[m]`` index of each marker's point, row-major, or ABSENT.
        expected_px: ``(m, 2)`` where the smooth model has each marker, px.
        stray: Indices of points that belong to no marker.
        staggered: Whether every second row is shifted by half a pitch.
        fits: The shape that the points fill, where another one was asked for.
    """

    shape: tuple[int, int] | None
    point: NDArray[np.int64]
    expected_px: NDArray[np.float64]
    stray: list[int] = field(default_factory=list)
    staggered: bool = False
    fits: tuple[int, int] | None = None

    @property
    def missing(self) -> NDArray[np.int64]:
        """Indices of the markers without a point."""
        return np.flatnonzero(self.point == ABSENT)


def find_layout(
    points_px: NDArray[np.float64],
    size: tuple[int, int],
    shape: tuple[int, int] | None = None,
    kind: LayoutKind = "auto",
) -> Layout:
    """Sort points into a layout.

    Args:
        points_px: ``(n, 2)`` candidates, px.
        size: ``(width, height)`` of the image.
        shape: ``(rows, columns)`` where it is known; None finds it.
        kind: What the points are; "auto" tells grids from staggered rows.

    Raises:
        CalibrationError: There is no point.

    Example:
        >>> import numpy as np
        >>> points = np.array([[30.0, 30], [10, 10], [30, 10], [10, 30], [50, 30], [50, 10]])
        >>> layout = find_layout(points, (60, 40))
        >>> layout.shape, layout.point.tolist()
        ((2, 3), [1, 2, 5, 3, 0, 4])
    """
    points = np.asarray(points_px, np.float64)
    if len(points) == 0:
        raise CalibrationError("no candidate for a marker was found")
    if kind == "free":
        order = np.lexsort(points.T)
        return Layout(None, order, points[order])
    lattices = [
        one for basis, phases in bases(points, kind) for one in labelled(points, basis, phases)
    ]
    lattice = min(lattices, key=lambda one: one.there()[1].size)
    own = _bounds(lattice, size)
    if shape is None:
        return _arranged(lattice, own) if own else _ragged(lattice)
    low, there = lattice.there()
    first = _best_placed(there, shape)
    asked = (low[0] + first[0], low[1] + first[1]), shape
    layout, left_out = _arranged(lattice, asked), there.sum()
    left_out -= np.count_nonzero(layout.point != ABSENT)
    return replace(layout, fits=own[1]) if own and left_out and own[1] != shape else layout


def _arranged(lattice: Lattice, bounds: Bounds) -> Layout:
    (row, column), (rows, columns) = bounds
    point = np.full(rows * columns, ABSENT, np.int64)
    for index, (i, j) in lattice.cells().items():
        if 0 <= i - row < rows and 0 <= j - column < columns:
            point[(i - row) * columns + j - column] = index
    every = [(row + i, column + j) for i in range(rows) for j in range(columns)]
    return _layout(lattice, (rows, columns), point, lattice.expected_px(every))


def _ragged(lattice: Lattice) -> Layout:
    cells = lattice.cells()
    point = sorted(cells, key=lambda index: cells[index])
    expected_px = lattice.expected_px([cells[index] for index in point])
    return _layout(lattice, None, np.array(point, np.int64), expected_px)


def _layout(
    lattice: Lattice,
    shape: tuple[int, int] | None,
    point: NDArray[np.int64],
    expected_px: NDArray[np.float64],
) -> Layout:
    used = set(point.tolist())
    stray = [index for index in range(len(lattice.points)) if index not in used]
    return Layout(shape, point, expected_px, stray, lattice.phase is not None)


def _bounds(lattice: Lattice, size: tuple[int, int]) -> Bounds | None:
    """Return the first row and column, and rows and columns; None where no rectangle fits."""
    low, there = lattice.there()
    across = lattice.model[1]
    level = lattice.phase is None and abs(across[1]) <= LEVEL_SLOPE * abs(across[0])
    if not level and len(lattice.labels) > 1:
        return (low, (there.shape[0], there.shape[1])) if _enclosed(there, lattice).all() else None
    every = [(low[0] + i, low[1] + j) for i in range(there.shape[0]) for j in range(there.shape[1])]
    expected = lattice.expected_px(every)
    outside = (expected < 0) | (expected > np.array(size) - 1)
    off = np.full(there.shape, np.inf)
    for index, (i, j) in lattice.cells().items():
        place = expected[(i - low[0]) * there.shape[1] + j - low[1]]
        off[i - low[0], j - low[1]] = np.hypot(*(lattice.points[index] - place)) / lattice.pitch_px
    hidden = np.asarray(outside.any(axis=1)).reshape(there.shape)
    trimmed = _trimmed(there, hidden, off)
    if trimmed is None:
        return None
    first, last = trimmed
    return (low[0] + first[0], low[1] + first[1]), (last[0] - first[0], last[1] - first[1])


def _enclosed(there: NDArray[np.bool_], lattice: Lattice) -> NDArray[np.bool_]:
    # Cells with a point, or between two points of their row or of their (straight) column.
    out = there.copy()
    for axis in (1,) if lattice.phase is not None else (0, 1):
        before = np.maximum.accumulate(there, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(there, axis), axis=axis), axis)
        out |= before & after
    return out


def _best_placed(there: NDArray[np.bool_], shape: tuple[int, int]) -> Label:
    rows, columns = shape
    padded = np.pad(there, ((rows - 1, rows - 1), (columns - 1, columns - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, shape).sum(axis=(2, 3))
    first = np.unravel_index(int(windows.argmax()), windows.shape)
    return int(first[0]) - rows + 1, int(first[1]) - columns + 1


def _trimmed(
    there: NDArray[np.bool_], hidden: NDArray[np.bool_], off: NDArray[np.float64]
) -> Bounds | None:
    # Take off border lines of stray points; None where markers fill a border line in part, since
    # the image ends there.
    first, last = [0, 0], list(there.shape)
    trimming = True
    while trimming:
        trimming = False
        for axis, side in itertools.product((0, 1), (0, 1)):
            span = [slice(first[0], last[0]), slice(first[1], last[1])]
            line = last[axis] - 1 if side else first[axis]
            span[axis] = slice(line, line + 1)
            found, unseen = there[tuple(span)].ravel(), hidden[tuple(span)].ravel()
            few = found.mean() < FEWEST_SHARE
            lost = not found.all() and unseen[~found].all()
            if last[axis] - first[axis] > 1 and (few or lost):
                if lost and off[tuple(span)].ravel()[found].min(initial=np.inf) < ON_LATTICE:
                    return None
                first[axis], last[axis] = first[axis] + (1 - side), last[axis] - side
                trimming = True
    return (first[0], first[1]), (last[0], last[1])
