"""Pass one of the calibration: from an empty map to a grid of markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.contrast_steps import ContrastSteps
from spikingtac.markers.calibration.grid import Grid, find_grid
from spikingtac.markers.calibration.slide_map import SlideMap
from spikingtac.markers.calibration.slides import Slides
from spikingtac.markers.published.blobs import BlobConfig, BlobDetector, Blobs

AREA_SHARES = (0.45, 2.2)
"""Blobs of a smaller or larger share of the median area are no markers, or two."""

EVEN_LOOKS = 16
"""Looks at regular times, beside those at rests: a recording may have no rest."""

MISSING_COST, STRAY_COST = 2.0, 0.5
"""What a gap and a stray blob take from a look's score, in markers found."""

MOST_NAMED = 8
"""Missing markers that an error names one by one."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """The best look at the grid.

    Attributes:
        index: How many events came before it.
        grid: Which candidate is which marker.
        center_px: ``(rows * columns, 2)`` where each marker was seen; missing ones: is expected.
        radius_px: ``(rows * columns,)`` radii from the blobs' areas, px; missing ones: the median.
        level: ``(height, width)`` map at the END of the recording, to go back from.
    """

    index: int
    grid: Grid
    center_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    level: NDArray[np.float32]


def sight_markers(
    slides: Slides,
    steps: ContrastSteps,
    rests_us: NDArray[np.int64],
    blobs: BlobConfig,
    shape: tuple[int, int] | None,
) -> Sighting:
    """Look for the grid at every rest and at regular times; return the best look.

    Args:
        slides: The recording.
        steps: What one event of each pixel stands for.
        rests_us: ``(n, 2)`` rests, us since the start.
        blobs: What counts as a candidate.
        shape: ``(rows, columns)``, or None to find it.

    Raises:
        CalibrationError: Nowhere is a candidate.
    """
    even = np.linspace(0, slides.duration_us, EVEN_LOOKS + 1)[1:].astype(np.int64)
    looks = np.unique(slides.index_at(np.concatenate([rests_us.mean(axis=1), even]).astype(int)))
    slide_map, detector = SlideMap(slides, steps), BlobDetector(slides.size, blobs)
    best: Sighting | None = None
    best_score = -np.inf
    for index in (*looks.tolist(), len(slides)):
        slide_map.move_to(index)
        found = _alike(detector.detect(slide_map.values))
        if not len(found):
            continue
        grid = find_grid(found.center_px, slides.size, shape)
        gaps = len(grid.missing)
        score = len(grid.point) - gaps * (1 + MISSING_COST) - STRAY_COST * len(grid.stray)
        # Later looks win ties: the map has filled further.
        if score >= best_score:
            best, best_score = _sighting(index, grid, found, slide_map.level), score
    if best is None:
        raise CalibrationError(_nothing_found(steps))
    return Sighting(best.index, best.grid, best.center_px, best.radius_px, slide_map.level)


def _alike(blobs: Blobs) -> Blobs:
    whole = blobs.area_px[~blobs.cut] if (~blobs.cut).any() else blobs.area_px
    usual = float(np.median(whole)) if len(whole) else 0.0
    least, most = (share * usual for share in AREA_SHARES)
    keep = (blobs.area_px >= least) & (blobs.area_px <= most)
    return Blobs(blobs.center_px[keep], blobs.area_px[keep], blobs.mass[keep], blobs.cut[keep])


def _sighting(index: int, grid: Grid, blobs: Blobs, level: NDArray[np.float32]) -> Sighting:
    there = np.setdiff1d(np.arange(len(grid.point)), grid.missing)
    center, radius = grid.expected_px.copy(), np.zeros(len(grid.point))
    center[there] = blobs.center_px[grid.point[there]]
    radius[there] = np.sqrt(blobs.area_px[grid.point[there]] / np.pi)
    # A cut blob shows a part of its area only.
    radius = np.where((radius > 0) & ~_cut(grid, blobs), radius, 0.0)
    whole = radius > 0
    radius[~whole] = np.median(radius[whole]) if whole.any() else np.sqrt(blobs.area_px.max() / 3)
    return Sighting(index, grid, center, radius, level)


def _cut(grid: Grid, blobs: Blobs) -> NDArray[np.bool_]:
    return np.where(grid.point >= 0, blobs.cut[grid.point], False)


def _nothing_found(steps: ContrastSteps) -> str:
    return (
        f"no marker appeared in the map (full swings of brightness seen: {steps.swings.sum():,}); "
        "record slides that move every marker by more than its diameter, to and fro in several "
        "directions; if the markers are darker than the ground, give --polarity dark"
    )


def missing_markers_text(grid: Grid, size: tuple[int, int]) -> str:
    """Say which markers of a grid are missing, where they should be, and where to slide."""
    rows, columns = grid.shape
    named = [
        f"row {index // columns + 1}, column {index % columns + 1} "
        f"(expected near x {grid.expected_px[index][0]:.0f}, y {grid.expected_px[index][1]:.0f} px)"
        for index in grid.missing[:MOST_NAMED]
    ]
    more = len(grid.missing) - len(named)
    regions = sorted({_region(grid.expected_px[index], size) for index in grid.missing})
    return (
        f"{len(grid.missing)} of {rows * columns} markers of the {rows}x{columns} grid were not "
        f"found: {'; '.join(named)}{f'; and {more} more' if more else ''}. Slide over the "
        f"{' and the '.join(regions)} of the skin, to and fro, by more than a marker's diameter, "
        f"and record again; if they are broken, give --allow-missing {len(grid.missing)}; if the "
        "grid is another, give --grid ROWSxCOLUMNS"
    )


def _region(position_px: NDArray[np.float64], size: tuple[int, int]) -> str:
    third = np.clip(np.floor(3 * position_px / np.array(size)), 0, 2).astype(int)
    across, down = ("left", "middle", "right")[third[0]], ("upper", "middle", "lower")[third[1]]
    return "middle" if across == down else f"{down} {across}"
