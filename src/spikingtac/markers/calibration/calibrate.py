"""Calibrate a sensor from any recording in which its markers move (section IV-D, and ours).

The balance of ON and OFF events tells what one of them stands for; the maps at rest show the
markers; the grid is found in them; the markers are followed through the recording; and places,
radii, edges and steps are refined until ideal pixels fire what the real ones fired. Slides are
motion like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import MARKER_NUMBERS, MEASURED
from spikingtac.calibration.lens_fit import with_lens
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.source import EventSource, refuse_path
from spikingtac.markers.calibration.buffered_events import (
    BufferedSource,
    buffer_events,
    without_hot_pixels,
)
from spikingtac.markers.calibration.course import Course
from spikingtac.markers.calibration.disc_levels import REACH_EDGES, Discs
from spikingtac.markers.calibration.finding.rest import RestConfig
from spikingtac.markers.calibration.finding.sighting import (
    FindingConfig,
    Look,
    look_at,
    refuse_gaps,
)
from spikingtac.markers.calibration.first_course import first_course
from spikingtac.markers.calibration.layout import LayoutKind, expected_places
from spikingtac.markers.calibration.quality import (
    Quality,
    judge,
    level_changes,
    own_contradiction,
    provenance,
    refuse_without_grid,
)
from spikingtac.markers.calibration.reference import (
    Method,
    displaced_before,
    reference,
)
from spikingtac.markers.calibration.refinement.recovery import with_recovery
from spikingtac.markers.calibration.refinement.refine import Refined, choose_states, refine
from spikingtac.markers.calibration.samples import choose_samples
from spikingtac.markers.calibration.swings import LearnedSteps
from spikingtac.markers.calibration.trial_tracking.step_scale import with_step_scale
from spikingtac.markers.calibration.trial_tracking.tracked_reference import with_tracked_reference
from spikingtac.markers.graded.appearance import nearest_marker
from spikingtac.markers.lag.recording_lag import slide_lag_us
from spikingtac.markers.published.blobs import BlobConfig

LagEstimator = Callable[[EventSource, Calibration], float | None]
"""Learns ``lag_us`` from the recording and the calibration so far; None where it cannot."""

CONTRASTS = (1.3, 12.0)
"""Least and largest contrast that the steps may stand for."""

FIRST_EDGE_PX, FIRST_CONTRAST = 0.8, 3.3
"""Edge width and contrast from which the refinement begins."""

FIRST_RADIUS_SHARE = 0.95
"""Radius from which it begins, as a share of that of the blobs, which the blur makes larger."""

BEYOND_RADII = 0.5
"""A marker whose centre lies further beyond the border, in radii, is left out: the part in sight,
less than a fifth of it, does not tell its place."""

PIXEL_SHARE = 0.3
"""Share of a pixel's own deviation from its marker's step that the tracker is given. In few swings
pixels differ by where the rim stops as well as by their thresholds (simulated: with all of it the
twin's tracks err by 0.017 px more, and those on v2e by 0.007 px less)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationConfig:
    """Settings of a calibration; every one has a default.

    Attributes:
        grid: ``(rows, columns)``, or None to find it.
        layout: What the markers are; "auto" tells grids from staggered rows, "free" are any.
        pitch_mm: Distance of neighbouring markers on the skin, mm, for ``px_per_mm``.
        lens: Whether to fit a lens to the grid, which must be flat and needs ``pitch_mm``.
        polarity: White markers on dark ground, dark on light, or "auto" to find out.
        method: How rests become a reference
            (:mod:`spikingtac.markers.calibration.reference`).
        allow_missing: So many markers may be missing: they are put where their neighbours expect
            them, and named. None allows a third.
        threshold: Contrast threshold of the camera, log intensity. Only the product of steps and
            contrast can be learnt from events, so it sets the scale of ``contrast``; 0.25 is the
            usual setting, and a wrong one shifts radii by some 0.1 px.
        most_events: Bound of the memory: 8 bytes each.
        rest: How silence is told.
        blobs: What counts as a candidate for a marker.
    """

    grid: tuple[int, int] | None = None
    layout: LayoutKind = "auto"
    pitch_mm: float | None = None
    lens: bool = False
    polarity: Literal["auto", "white", "dark"] = "auto"
    method: Method = "rest-mean"
    allow_missing: int | None = None
    threshold: float = 0.25
    most_events: int = 100_000_000
    rest: RestConfig = field(default_factory=RestConfig)
    blobs: BlobConfig = field(default_factory=lambda: FindingConfig().blobs)

    def __post_init__(self) -> None:
        if self.pitch_mm is not None and not self.pitch_mm > 0.0:
            raise ConfigError(f"pitch_mm is {self.pitch_mm}, it must be positive")
        if self.lens and self.pitch_mm is None:
            raise ConfigError("the lens is fitted to a grid of known pitch; give pitch_mm, too")
        if self.allow_missing is not None and self.allow_missing < 0:
            raise ConfigError(f"allow_missing is {self.allow_missing}, it must not be negative")
        if not self.threshold > 0.0:
            raise ConfigError(f"threshold is {self.threshold}, it must be positive")
        _ = self.finding  # checks its own part

    @property
    def finding(self) -> FindingConfig:
        """The part that the search for markers reads."""
        return FindingConfig(
            grid=self.grid,
            layout=self.layout,
            polarity=self.polarity,
            rest=self.rest,
            blobs=self.blobs,
        )


def calibrate(
    source: EventSource,
    config: CalibrationConfig | None = None,
    estimate_lag: LagEstimator | None = slide_lag_us,
) -> Calibration:
    """Learn a sensor's calibration from a recording in which its markers move.

    Args:
        source: The recording, or a camera that ends; it is read once.
        config: What is known beforehand.
        estimate_lag: Fills in ``lag_us`` at the end; None leaves it unknown.

    Raises:
        CalibrationError: The recording shows no grid of markers, or too few of them; says why,
            where, and what to do.
        ConfigError: A path is given instead of a source.
    """
    refuse_path(source)
    config = config or CalibrationConfig()
    events, hot_px = without_hot_pixels(buffer_events(source, config.most_events))
    look = look_at(events, config.finding)
    refined, learned = _explained(look, config)
    noise = look.noise(_reach_px(refined.discs))
    quality = judge(level_changes(look.events, refined), refined.events, noise)
    refuse_without_grid(quality)
    layout = look.sighting.layout
    if layout.shape is not None:
        missing = np.flatnonzero(~quality.measured)
        refuse_gaps(layout, look.events.size, missing, config.allow_missing)
    calibration = replace(_assembled(look, (refined, learned), quality, config), hot_px=hot_px)
    calibration = with_step_scale(look.events, refined, calibration)
    if config.method == "rest-mean":
        rests_us = look.rests_us[look.unloaded]
        calibration = with_tracked_reference(look.events, calibration, rests_us)
    calibration = within_sight(calibration)
    if config.pitch_mm is not None and len(calibration.radius_px) > 1:
        calibration = calibration.with_pitch(config.pitch_mm)
        if config.lens:
            calibration = with_lens(calibration, config.pitch_mm, staggered=layout.staggered)
    own = round(own_contradiction(look.events, calibration), 4)
    calibration = replace(calibration, provenance={**calibration.provenance, "contradiction": own})
    seen = look.events if look.polarity == "white" else look.events.inverted()
    lag_us = estimate_lag(BufferedSource(seen), calibration) if estimate_lag else None
    return calibration if lag_us is None else replace(calibration, lag_us=lag_us)


def _explained(look: Look, config: CalibrationConfig) -> tuple[Refined, LearnedSteps]:
    events, markers = look.events, len(look.sighting.center_px)
    index, still = choose_samples(look)
    discs = Discs(
        np.full(markers, FIRST_RADIUS_SHARE * look.sighting.radius_px),
        np.full(markers, FIRST_EDGE_PX),
        np.full(markers, FIRST_CONTRAST),
    )
    course, learned = first_course(look, index, still, discs)
    step = np.sqrt(learned.on * learned.off)
    discs = replace(discs, contrast=np.exp(config.threshold / step).clip(*CONTRASTS))
    start = Refined(
        course,
        choose_states(len(index), still, events.pixels),
        discs,
        learned.on,
        learned.off,
        learned.pixel,
        np.zeros(markers),
        np.zeros((markers, 4)),
    )
    about = still, _cells(look), look.noise(_reach_px(discs))
    return with_recovery(events, refine(events, start, *about), *about), learned


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


def _cells(look: Look) -> NDArray[np.int64]:
    return nearest_marker(look.sighting.center_px, look.events.size).ravel().astype(np.int64)


def _reach_px(discs: Discs) -> float:
    return float(np.median(discs.radius_px + REACH_EDGES * discs.edge_px))


def _assembled(
    look: Look,
    found: tuple[Refined, LearnedSteps],
    quality: Quality,
    config: CalibrationConfig,
) -> Calibration:
    refined, learned = found
    measured = quality.measured
    rest_px = refined.course.center_px[choose_samples(look)[1][look.unloaded, 1]]
    reference_px = _reference_px(look, refined.course, rest_px, config.method)
    layout = look.sighting.layout
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
        **_appearance(refined, learned, measured, _cells(look)),
        provenance={
            "method": config.method,
            "unloaded_rests_us": unloaded_us.tolist(),
            "missing": np.flatnonzero(~measured).tolist(),
            "swings": np.round(learned.swings, 1).tolist(),
            "residual": np.round(refined.residual, 4).tolist(),
            "scatter_px": np.round(scatter_px, 4).tolist(),
            **provenance(quality),
            "stray_px": look.sighting.stray_px.round(1).tolist(),
            "fitting_grid": layout.fits,
        },
    )


def _reference_px(
    look: Look, course: Course, rest_px: NDArray[np.float64], method: Method
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
