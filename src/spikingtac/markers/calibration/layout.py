"""Layout of the markers from a set of points: rows and columns, staggered rows, or free.

The paper has 8x8 markers and does not say how they are identified.
"""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.lattice import Lattice, LayoutKind, cells_of, find_lattice
from spikingtac.types import FloatArray

# Distance from its lattice cell, as a share of the pitch, up to which a point in a nearly empty
# border line is a marker; of points at random within REACH one in eleven is so near.
ON_LATTICE = 0.12

# Largest slope of the rows, 3 degrees, at which a grid is assumed to be a rectangle along the
# image, so that a corner without a marker is a missing marker. At larger slopes the image may cut
# off corners.
LEVEL_SLOPE = 0.05

# A border row or column with a smaller share of its markers is taken for stray points.
FEWEST_SHARE = 1 / 3

ABSENT = -1

Rectangle = tuple[NDArray[np.int64], tuple[int, int]]  # First row and column, and the shape.


@dataclass(frozen=True, slots=True)
class Layout:
    """Assignment of points to markers.

    Attributes:
        shape: ``(rows, columns)``, or None where the markers do not fill rows.
        point: ``int64[m]`` index of each marker's point, row-major, or ABSENT.
        expected_px: ``(m, 2)`` position of each marker by the smooth model, px.
        stray: Indices of points that belong to no marker.
        staggered: Whether every second row is shifted by half a pitch.
        fits: The shape that the points fill, if another one was requested.
    """

    shape: tuple[int, int] | None
    point: NDArray[np.int64]
    expected_px: FloatArray
    stray: list[int] = field(default_factory=list)
    staggered: bool = False
    fits: tuple[int, int] | None = None


def find_layout(
    points: FloatArray,
    size: tuple[int, int],
    shape: tuple[int, int] | None = None,
    kind: LayoutKind = "auto",
) -> Layout:
    """Assign points to a layout.

    Args:
        points: ``(n, 2)`` candidates, px, two at least.
        size: ``(width, height)`` of the image.
        shape: ``(rows, columns)`` where it is known; None finds it.
        kind: What the points are; "auto" tells grids from staggered rows.

    Example:
        >>> import numpy as np
        >>> points = np.array([[30.0, 30], [10, 10], [30, 10], [10, 30], [50, 30], [50, 10]])
        >>> layout = find_layout(points, (60, 40))
        >>> layout.shape, layout.point.tolist()
        ((2, 3), [1, 2, 5, 3, 0, 4])
    """
    if kind == "free":
        order = np.lexsort(points.T)
        return Layout(None, order, points[order])
    lattice = find_lattice(points, kind)
    own = _rectangle(lattice, size)
    if shape is None:
        return _arranged(lattice, own)
    first, there = lattice.occupied()
    requested = _arranged(lattice, (first + _best_placed(there, shape), shape))
    absent_px = requested.expected_px[requested.point == ABSENT]
    left_out = len(lattice.index) + len(absent_px) > len(requested.point)
    # Markers that would lie beyond the border are of another grid, too.
    unfit = left_out or ((absent_px < 0) | (absent_px > np.array(size) - 1)).any()
    return replace(requested, fits=own[1]) if own and own[1] != shape and unfit else requested


def _arranged(lattice: Lattice, rectangle: Rectangle | None) -> Layout:
    # The markers of the rectangle, or, where there is none, those that have points.
    if rectangle is None:
        order = np.lexsort(lattice.cell.T[::-1])
        shape, cell, point = None, lattice.cell[order], lattice.index[order]
    else:
        first, shape = rectangle
        cell, point = cells_of(first, shape), np.full(shape, ABSENT, np.int64)
        at = lattice.cell - first
        inside = ((at >= 0) & (at < shape)).all(axis=1)
        point[tuple(at[inside].T)] = lattice.index[inside]
    stray = np.setdiff1d(np.arange(len(lattice.points)), point).tolist()
    return Layout(shape, point.ravel(), lattice.expected_px(cell), stray, lattice.phase is not None)


def _rectangle(lattice: Lattice, size: tuple[int, int]) -> Rectangle | None:
    """Return the first row and column, and rows and columns; None where no rectangle fits."""
    first, there = lattice.occupied()
    expected_px = lattice.expected_px(cells_of(first, there.shape)).reshape(*there.shape, 2)
    last_px, across = np.array(size) - 1, lattice.model[1]
    level = lattice.phase is None and abs(across[1]) <= LEVEL_SLOPE * abs(across[0])
    if not level:
        # Empty cells nearer to the border than all visible markers are cut off by the image; an
        # empty cell far inside is a missing marker.
        border_px = np.minimum(expected_px, last_px - expected_px).min(axis=2)
        deep = (border_px - border_px[there].min())[~_enclosed(there, lattice)] / lattice.pitch_px
        missing = lattice.phase is None and deep.max(initial=0.0) > 1.0 and deep.min() > -ON_LATTICE
        return (first, (there.shape[0], there.shape[1])) if missing or not deep.size else None
    hidden = ((expected_px < 0) | (expected_px > last_px)).any(axis=2)
    off_px = np.hypot(*(lattice.points[lattice.index] - lattice.expected_px(lattice.cell)).T)
    near = np.zeros(there.shape, bool)
    near[tuple((lattice.cell - first).T)] = off_px < ON_LATTICE * lattice.pitch_px
    # Border lines of stray points are removed; where the image cuts a line of markers, there is no
    # rectangle.
    window = np.stack([there, hidden, near])
    while True:
        for axis, side in itertools.product((1, 2), (0, -1)):
            found, unseen, exact = np.asarray(window.take(side, axis))
            few, lost = found.mean() < FEWEST_SHARE, not found.all() and unseen[~found].all()
            if window.shape[axis] > 1 and (few or lost):
                if lost and exact.any():
                    return None
                window = np.delete(window, side, axis)
                first[axis - 1] += side == 0
                break
        else:
            return first, (window.shape[1], window.shape[2])


def _enclosed(there: NDArray[np.bool_], lattice: Lattice) -> NDArray[np.bool_]:
    # Cells with a point, or between two points of their row or of their (straight) column.
    out = there.copy()
    for axis in (1,) if lattice.phase is not None else (0, 1):
        before = np.maximum.accumulate(there, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(there, axis), axis=axis), axis)
        out |= before & after
    return out


def _best_placed(there: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.int64]:
    from scipy.signal import correlate2d  # 0.1 s that other verbs need not wait

    fits = correlate2d(there.astype(int), np.ones(shape, int))
    return np.array(np.unravel_index(fits.argmax(), fits.shape), np.int64) + 1 - shape


MOST_MISSING_SHARE = 1 / 3  # A grid of which more is missing was not found.

MOST_NAMED = 8  # Missing markers that an error names one by one.


def refuse_gaps(
    layout: Layout, size: tuple[int, int], missing: NDArray[np.int64], allowed: int | None
) -> None:
    """Refuse a grid of which too many markers are missing.

    Args:
        layout: The layout.
        size: ``(width, height)``.
        missing: Indices of the markers that the recording does not show.
        allowed: How many may be; None allows a third.

    Raises:
        CalibrationError: More are missing; names them and says where to touch.
    """
    most = int(MOST_MISSING_SHARE * len(layout.point)) if allowed is None else allowed
    if layout.shape is None or len(missing) <= most:
        return
    place, (rows, columns) = layout.expected_px, layout.shape
    named = [
        f"{marker_name(index, layout.shape)} "
        f"(expected near x {place[index][0]:.0f}, y {place[index][1]:.0f} px)"
        for index in missing[:MOST_NAMED]
    ]
    more = len(missing) - len(named)
    regions = sorted({region(place[index], size) for index in missing})
    raise CalibrationError(
        f"{len(missing)} of {len(place)} markers of the {rows}x{columns} grid were not "
        f"found: {'; '.join(named)}{f'; and {more} more' if more else ''}. Press or slide on the "
        f"{' and the '.join(regions)} of the skin, until the markers there move by more than their "
        f"diameter, and record again; if they are broken, give --allow-missing {len(missing)}; if "
        "the grid is another, give --grid ROWSxCOLUMNS"
    )


def marker_name(index: int, shape: tuple[int, int] | None) -> str:
    """Return the name of a marker: ``row 1, column 2``, or its number without a grid.

    Example:
        >>> marker_name(9, (8, 8)), marker_name(9, None)
        ('row 2, column 2', 'marker 9')
    """
    if shape is None:
        return f"marker {index}"
    return f"row {index // shape[1] + 1}, column {index % shape[1] + 1}"


def region(position_px: FloatArray, size: tuple[int, int]) -> str:
    """Return the ninth of the image that holds a position, as ``upper left``.

    Args:
        position_px: ``(2,)`` the position, px.
        size: ``(width, height)``.
    """
    third = np.clip(np.floor(3 * position_px / np.array(size)), 0, 2).astype(int)
    across, down = ("left", "middle", "right")[third[0]], ("upper", "middle", "lower")[third[1]]
    return "middle" if across == down else f"{down} {across}"
