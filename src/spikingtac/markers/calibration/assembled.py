"""From what was learned of a recording to the values of a calibration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import MARKER_NUMBERS, MEASURED
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.disc_levels import Course
from spikingtac.markers.calibration.find_markers import Overview
from spikingtac.markers.calibration.first_course import choose_samples
from spikingtac.markers.calibration.lattice import expected_places
from spikingtac.markers.calibration.quality import (
    Quality,
    provenance,
)
from spikingtac.markers.calibration.reference import (
    Method,
    displaced_before,
    reference,
)
from spikingtac.markers.calibration.refine import Refined
from spikingtac.markers.calibration.swings import LearnedSteps
from spikingtac.markers.graded.appearance import nearest_marker

# A marker whose centre lies further beyond the border, in radii, is left out: the part in sight,
# less than a fifth of it, does not tell its place.
BEYOND_RADII = 0.5

# Share of a pixel's own deviation from its marker's step that the tracker is given. In few swings
# pixels differ by where the rim stops as well as by their thresholds (simulated: with all of it
# the twin's tracks err by 0.017 px more, and those on v2e by 0.007 px less).
PIXEL_SHARE = 0.3


def cells(look: Overview) -> NDArray[np.int64]:
    """Return the nearest marker of each pixel, row by row."""
    return nearest_marker(look.markers.center_px, look.events.size).ravel().astype(np.int64)


def assembled(
    look: Overview,
    found: tuple[Refined, LearnedSteps],
    quality: Quality,
    method: Method,
) -> Calibration:
    """Return the calibration of what was seen, refined and judged; steps as events tell them."""
    refined, learned = found
    measured = quality.measured
    rest_px = refined.course.center_px[choose_samples(look)[1][look.unloaded, 1]]
    reference_px = _reference_px(look, refined.course, rest_px, method)
    layout = look.markers.layout
    if layout.shape is not None and not layout.staggered:
        expected_px = expected_places(reference_px, measured, layout.shape)
        reference_px[~measured] = expected_px[~measured]
    scatter_px = np.sqrt(((rest_px - reference_px) ** 2).sum(axis=2).mean(axis=0))
    unloaded_us = look.events.t_start_us + look.rests_us[look.unloaded]
    return Calibration(
        reference_px=reference_px,
        grid=layout.shape,
        size=look.events.size,
        polarity=look.polarity,
        marker_measured=measured,
        recovery_s=refined.recovery_s or None,
        **_appearance(refined, learned, measured, cells(look)),
        provenance={
            "method": method,
            "unloaded_rests_us": unloaded_us.tolist(),
            "missing": np.flatnonzero(~measured).tolist(),
            "swings": np.round(learned.swings, 1).tolist(),
            "residual": np.round(refined.residual, 4).tolist(),
            "scatter_px": np.round(scatter_px, 4).tolist(),
            **provenance(quality),
            "stray_px": look.markers.stray_px.round(1).tolist(),
            "fitting_grid": layout.fits,
        },
    )


def _reference_px(
    look: Overview, course: Course, rest_px: NDArray[np.float64], method: Method
) -> NDArray[np.float64]:
    rests_us = look.rests_us[look.unloaded]
    at_us = look.events.times_at(course.index)
    displaced_px = displaced_before(rests_us, rest_px, at_us, course.center_px)
    return reference(rest_px, rests_us, displaced_px, method)


def _appearance(
    refined: Refined,
    learned: LearnedSteps,
    measured: NDArray[np.bool_],
    cell: NDArray[np.int64],
) -> dict[str, Any]:
    # Markers that were not measured look like the others; pixels without a swing have no own step.
    own = {
        "marker_edge_px": refined.discs.edge_px,
        "marker_contrast": refined.discs.contrast,
        "marker_step_on": refined.on,
        "marker_step_off": refined.off,
        "radius_px": refined.discs.radius_px,
    }
    usual = {name: float(np.median(value[measured])) for name, value in own.items()}
    known = learned.pixel_swings > 0
    cell = cell.reshape(known.shape)
    return {
        **{name: np.where(measured, value, usual[name]) for name, value in own.items()},
        "edge_px": usual["marker_edge_px"],
        "contrast": usual["marker_contrast"],
        "step_on": usual["marker_step_on"],
        "step_off": usual["marker_step_off"],
        "step_on_map": np.where(known, _drawn_to(refined.pixel.on, refined.on[cell]), 0.0),
        "step_off_map": np.where(known, _drawn_to(refined.pixel.off, refined.off[cell]), 0.0),
    }


def _drawn_to(pixel: NDArray[np.float32], marker: NDArray[np.float64]) -> NDArray[np.float32]:
    return (marker * (pixel / marker) ** PIXEL_SHARE).astype(np.float32)


def within_sight(calibration: Calibration) -> Calibration:
    """Return a calibration without markers beyond the border, and without rows that they leave.

    Where there are no rows, markers that were not measured are left out, too: nothing tells their
    places.
    """
    place_px, size = calibration.reference_px, np.array(calibration.size)
    reach_px = BEYOND_RADII * calibration.radius_px[:, np.newaxis]
    inside = (place_px >= -reach_px) & (place_px <= size - 1 + reach_px)
    keep = np.asarray(inside.all(axis=1), bool)
    if calibration.grid is None and calibration.marker_measured is not None:
        keep &= calibration.marker_measured
    if keep.all() or not keep.any():
        return calibration
    left_out = {"left_out_px": place_px[~keep].round(2).tolist()}
    provenance = {name: _kept(value, keep, name) for name, value in calibration.provenance.items()}
    of_markers = {
        name: value[keep]
        for name in ("reference_px", "radius_px", *MARKER_NUMBERS, MEASURED)
        if (value := getattr(calibration, name)) is not None
    }
    grid = _whole_grid(keep, calibration.grid)
    return replace(calibration, grid=grid, provenance=provenance | left_out, **of_markers)


def _kept(value: Any, keep: NDArray[np.bool_], name: str) -> Any:
    # What a note says of the markers that are kept: numbers of markers, or a value for each.
    if name in ("missing", "doubtful"):
        return [int(np.count_nonzero(keep[:one])) for one in value if keep[one]]
    if isinstance(value, list) and len(value) == len(keep):
        return [one for one, stays in zip(value, keep, strict=True) if stays]
    return value


def _whole_grid(keep: NDArray[np.bool_], grid: tuple[int, int] | None) -> tuple[int, int] | None:
    # What is left of a grid that has lost whole rows or columns; None where it has lost parts.
    if grid is None:
        return None
    there = keep.reshape(grid)
    rows, columns = there.any(axis=1), there.any(axis=0)
    whole = there[np.ix_(rows, columns)].all()
    return (int(rows.sum()), int(columns.sum())) if whole else None
