"""Where the markers are seen at rest, and whether they are a grid at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.grid import Grid, find_grid
from spikingtac.markers.published.blobs import BlobConfig, BlobDetector, Blobs

SMOOTH_PX = 1.0
"""Width of the Gaussian that takes single pixels' noise off before blobs are looked for."""

AREA_SHARES = (0.25, 3.0)
"""Blobs of a smaller or larger share of the median area are no markers, or two."""

FEWEST_MARKERS = 3
"""Fewer markers are no grid."""

MOST_MISSING_SHARE = 1 / 3
"""A grid of which more is missing was not found."""

MOST_STRAY_SHARE = 0.5
"""Blobs that fit into no grid, as a share of those that do, above which there is no grid."""

MOST_NAMED = 8
"""Missing markers that an error names one by one."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """The grid as it is seen at rest.

    Attributes:
        grid: Which blob is which marker.
        center_px: ``(rows * columns, 2)`` where each marker was seen; missing ones: is expected.
        radius_px: Typical radius of the markers, px.
    """

    grid: Grid
    center_px: NDArray[np.float64]
    radius_px: float


def lit_share(maps: NDArray[np.float32]) -> float:
    """Return which share of the pixels shows a marker, on the average over maps.

    Of the two polarities the right one shows the fewer: discs, and not what they passed.
    """
    smooth = [gaussian_filter(level, SMOOTH_PX) > 0.5 for level in maps]
    return float(np.mean(smooth))


def sight_markers(
    level: NDArray[np.float32],
    size: tuple[int, int],
    blobs: BlobConfig,
    shape: tuple[int, int] | None,
) -> Sighting:
    """Find the grid in a map of the skin at rest.

    Args:
        level: ``(height, width)`` mean of the maps at rest.
        size: ``(width, height)``.
        blobs: What counts as a candidate.
        shape: ``(rows, columns)`` where it is known; None finds it.

    Raises:
        CalibrationError: No grid is there; says what was seen instead.
    """
    seen = BlobDetector(size, blobs).detect(gaussian_filter(level, SMOOTH_PX).astype(np.float32))
    found = _alike(seen)
    if len(found) < FEWEST_MARKERS:
        raise CalibrationError(
            f"no grid of markers: {len(found)} spots of equal size appeared where a grid has at "
            f"least {FEWEST_MARKERS}; record the sensor while something presses or slides on all "
            "of its skin, so that every marker moves by more than its diameter"
        )
    grid = find_grid(found.center_px, size, shape)
    there = grid.point >= 0
    count = int(there.sum())
    if count < FEWEST_MARKERS or len(grid.stray) > MOST_STRAY_SHARE * count:
        raise CalibrationError(
            f"no grid of markers: of {len(found)} spots only {count} lie in rows and columns; "
            "the recording seems to show something else than a marker sensor"
        )
    center_px = grid.expected_px.copy()
    center_px[there] = found.center_px[grid.point[there]]
    whole = found.area_px[~found.cut] if (~found.cut).any() else found.area_px
    return Sighting(grid, center_px, float(np.sqrt(np.median(whole) / np.pi)))


def refuse_gaps(
    grid: Grid, size: tuple[int, int], missing: NDArray[np.int64], allowed: int | None
) -> None:
    """Refuse a grid of which too many markers are missing.

    Args:
        grid: The grid.
        size: ``(width, height)``.
        missing: Indices of the markers that the recording does not show.
        allowed: How many may be; None allows a third.

    Raises:
        CalibrationError: More are missing; names them and says where to touch.
    """
    most = int(MOST_MISSING_SHARE * len(grid.point)) if allowed is None else allowed
    if len(missing) > most:
        raise CalibrationError(missing_markers_text(grid, size, missing))


def missing_markers_text(grid: Grid, size: tuple[int, int], missing: NDArray[np.int64]) -> str:
    """Say which markers of a grid are missing, where they should be, and where to touch."""
    rows, columns = grid.shape
    named = [
        f"row {index // columns + 1}, column {index % columns + 1} "
        f"(expected near x {grid.expected_px[index][0]:.0f}, y {grid.expected_px[index][1]:.0f} px)"
        for index in missing[:MOST_NAMED]
    ]
    more = len(missing) - len(named)
    regions = sorted({_region(grid.expected_px[index], size) for index in missing})
    return (
        f"{len(missing)} of {rows * columns} markers of the {rows}x{columns} grid were not "
        f"found: {'; '.join(named)}{f'; and {more} more' if more else ''}. Press or slide on the "
        f"{' and the '.join(regions)} of the skin, until the markers there move by more than their "
        f"diameter, and record again; if they are broken, give --allow-missing {len(missing)}; if "
        "the grid is another, give --grid ROWSxCOLUMNS"
    )


def _alike(blobs: Blobs) -> Blobs:
    whole = blobs.area_px[~blobs.cut] if (~blobs.cut).any() else blobs.area_px
    usual = float(np.median(whole)) if len(whole) else 0.0
    least, most = (share * usual for share in AREA_SHARES)
    keep = (blobs.area_px >= least) & (blobs.area_px <= most)
    return Blobs(blobs.center_px[keep], blobs.area_px[keep], blobs.mass[keep], blobs.cut[keep])


def _region(position_px: NDArray[np.float64], size: tuple[int, int]) -> str:
    third = np.clip(np.floor(3 * position_px / np.array(size)), 0, 2).astype(int)
    across, down = ("left", "middle", "right")[third[0]], ("upper", "middle", "lower")[third[1]]
    return "middle" if across == down else f"{down} {across}"
