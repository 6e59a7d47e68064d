"""Calibrate a sensor from any recording in which its markers move.

Find the discs in maps of the skin at rest and label their lattice; track them with a first guess;
refine one model of places, discs and steps until ideal pixels fire what the real ones fired; check
how much of the recording it explains. Slides are motion like any other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import MAPS, MARKER_NUMBERS, MEASURED
from spikingtac.calibration.lens import fit_lens
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.source import EventSource, refuse_path
from spikingtac.markers.calibration.corrections import Evidence, Model
from spikingtac.markers.calibration.find_markers import (
    FindingConfig,
    Overview,
    SeenMarkers,
    look_over,
)
from spikingtac.markers.calibration.first_model import first_model, tracked
from spikingtac.markers.calibration.lattice import expected_places
from spikingtac.markers.calibration.layout import Layout
from spikingtac.markers.calibration.quality import (
    Quality,
    judged,
    refuse_gaps,
    refuse_without_grid,
)
from spikingtac.markers.calibration.recording import buffer_events, without_hot_pixels
from spikingtac.markers.calibration.reference import Method, displaced_before, reference
from spikingtac.markers.calibration.refine import STEP_BOUNDS, refine, with_recovery
from spikingtac.markers.lag import slide_lag_us

# Learns ``lag_us`` from the recording and the calibration so far; None where it cannot.
LagEstimator = Callable[[EventSource, Calibration], float | None]

# Beginning of a recording from which a calibration by hand is completed, us: a few contacts.
FIRST_US = 15_000_000

# A marker whose centre lies further beyond the border, in radii, is left out: the part in sight,
# less than a fifth of it, does not tell its place.
BEYOND_RADII = 0.5

# Rounds of the refinement after each time that recovering pixels are tracked again.
RETRACKED_ROUNDS = (3, 10)

HEARD_EVENTS = 400.0  # Events near a marker, beyond noise, that tell its steps: 2 px of way.

# Share of a pixel's own deviation from its marker's step that the tracker is given: in few swings
# the rim's way counts, too. (Simulated: 2 to 4 % more error without; 0.017 px more with all of it.)
PIXEL_SHARE = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationConfig(FindingConfig):
    """What is known of a sensor beforehand; every field has a default.

    Attributes:
        pitch_mm: Distance of neighbouring markers on the skin, mm, for ``px_per_mm``.
        lens: Whether to fit a lens to the grid, which must be flat and needs ``pitch_mm``.
        method: How rests become a reference
            (:mod:`spikingtac.markers.calibration.reference`).
        allow_missing: So many markers may be missing: they are put where their neighbours expect
            them, and named. None allows a third.
    """

    pitch_mm: float | None = None
    lens: bool = False
    method: Method = "rest-mean"
    allow_missing: int | None = None

    def __post_init__(self) -> None:
        FindingConfig.__post_init__(self)
        if self.pitch_mm is not None and not self.pitch_mm > 0.0:
            raise ConfigError(f"pitch_mm is {self.pitch_mm}, it must be positive")
        if self.lens and self.pitch_mm is None:
            raise ConfigError("the lens is fitted to a grid of known pitch; give pitch_mm, too")
        if self.allow_missing is not None and self.allow_missing < 0:
            raise ConfigError(f"allow_missing is {self.allow_missing}, it must not be negative")


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
    events, hot_px = without_hot_pixels(buffer_events(source))
    view = look_over(events, config)
    calibration = _within_sight(_learned(view, config))
    if config.pitch_mm is not None and len(calibration.radius_px) > 1:
        calibration = calibration.with_pitch(config.pitch_mm)
        if config.lens:
            staggered = view.markers.layout.staggered
            calibration = with_lens(calibration, config.pitch_mm, staggered=staggered)
    return _with_lag(replace(calibration, hot_px=hot_px), view, estimate_lag)


def completed(source: EventSource, known: Calibration) -> Calibration:
    """Return a calibration that was written by hand with what the sensor's events teach.

    Steps, radii, edges, contrasts and lag are learned from the first seconds; places, grid and
    polarity stay. One that holds steps, or of which the recording teaches nothing, stays as it is.

    Args:
        source: The recording; it is read from its beginning.
        known: The calibration.
    """
    if known.step_on is not None or known.marker_step_on is not None:
        return known
    place_px = known.reference_px
    layout = Layout(known.grid, np.arange(len(place_px)), place_px)
    given = SeenMarkers(layout, place_px, place_px[:0], float(np.median(known.radius_px)))
    config = CalibrationConfig(polarity="dark" if known.polarity == "dark" else "white")
    try:
        events, hot_px = without_hot_pixels(buffer_events(source, FIRST_US))
        view = look_over(events, config, given)
        learned = _with_lag(_learned(view, config), view, slide_lag_us)
    except CalibrationError:
        return known
    return replace(
        learned,
        reference_px=place_px,
        hot_px=hot_px if known.hot_px is None else known.hot_px,
        px_per_mm=known.px_per_mm,
        lens=known.lens,
        hysteresis=known.hysteresis,
        provenance=known.provenance,
    )


def _learned(view: Overview, config: CalibrationConfig) -> Calibration:
    evidence, model = first_model(view)
    model = with_recovery(evidence, refine(evidence, model))
    # Known as such, recovering pixels show the markers better (recorded presses: .97 -> .73 px).
    for rounds in RETRACKED_ROUNDS if model.recovery_s else ():
        model = refine(evidence, tracked(view, model), rounds)
    quality = judged(evidence, model)
    refuse_without_grid(quality)
    layout = view.markers.layout
    if layout.shape is not None:
        missing = np.flatnonzero(~quality.measured)
        refuse_gaps(layout, view.events.size, missing, config.allow_missing)
    return _assembled(view, (evidence, model), quality, config.method)


def _assembled(
    view: Overview, learned: tuple[Evidence, Model], quality: Quality, method: Method
) -> Calibration:
    """Return the calibration that a refined model stands for."""
    (evidence, model), measured = learned, quality.measured
    rest_px = model.paths.center_px[evidence.still[view.unloaded, 1]]
    rests_us, at_us = view.rests_us[view.unloaded], view.events.times_at(model.paths.index)
    displaced_px = displaced_before(rests_us, rest_px, at_us, model.paths.center_px)
    reference_px = reference(rest_px, rests_us, displaced_px, method)
    layout = view.markers.layout
    if layout.shape is not None and not layout.staggered:
        expected_px = expected_places(reference_px, measured, layout.shape)
        reference_px[~measured] = expected_px[~measured]
    scatter_px = np.sqrt(((rest_px - reference_px) ** 2).sum(axis=2).mean(axis=0))
    return Calibration(
        reference_px=reference_px,
        grid=layout.shape,
        size=view.events.size,
        polarity=view.polarity,
        marker_measured=measured,
        recovery_s=model.recovery_s or None,
        **_appearance(model, quality),
        **_step_maps(evidence, model, measured),
        provenance={
            "method": method,
            "unloaded_rests_us": (view.events.t_start_us + rests_us).tolist(),
            "missing": np.flatnonzero(~measured).tolist(),
            "swings": np.round(model.swings, 1).tolist(),
            "residual": np.round(model.residual, 4).tolist(),
            "scatter_px": np.round(scatter_px, 4).tolist(),
            "quality": quality.word,
            "doubtful": np.flatnonzero(quality.doubtful).tolist(),
            "explained": np.round(quality.explained, 3).tolist(),
            "events": np.round(quality.events).astype(int).tolist(),
            "stray_px": view.markers.stray_px.round(1).tolist(),
            "fitting_grid": layout.fits,
        },
    )


def _appearance(model: Model, quality: Quality) -> dict[str, Any]:
    # Markers that were not measured look like the others; a pale one of their steps would be lost.
    measured, heard = quality.measured, quality.events >= HEARD_EVENTS
    own = {
        "marker_edge_px": model.discs.edge_px,
        "marker_contrast": model.discs.contrast,
        "marker_step_on": model.on,
        "marker_step_off": model.off,
        "radius_px": model.discs.radius_px,
    }
    usual = {name: float(np.median(value[measured])) for name, value in own.items()}
    sensor = ("edge_px", "contrast", "step_on", "step_off")
    known = {"marker_step_on": measured | heard, "marker_step_off": measured | heard}
    return {
        **{name: np.where(known.get(name, measured), v, usual[name]) for name, v in own.items()},
        **{name: usual[f"marker_{name}"] for name in sensor},
    }


def _step_maps(evidence: Evidence, model: Model, measured: NDArray[np.bool_]) -> dict[str, Any]:
    # Pixels without a full swing, and those of markers that were not measured, have no own step.
    maps, known = {}, measured[evidence.cell]
    for name, step, share in zip(MAPS, (model.on, model.off), model.pixel, strict=True):
        own = step[evidence.cell] * share**PIXEL_SHARE
        own = np.where(known & (np.abs(share - 1.0) > 1e-9), own.clip(*STEP_BOUNDS), 0.0)
        maps[name] = own.reshape(evidence.events.shape).astype(np.float32)
    return maps


def _within_sight(calibration: Calibration) -> Calibration:
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
    names = ("reference_px", "radius_px", *MARKER_NUMBERS, MEASURED)
    of_markers = {name: getattr(calibration, name)[keep] for name in names}
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


def _with_lag(
    calibration: Calibration, view: Overview, estimate_lag: LagEstimator | None
) -> Calibration:
    seen = view.events if view.polarity == "white" else view.events.inverted()
    lag_us = estimate_lag(seen, calibration) if estimate_lag else None
    return calibration if lag_us is None else replace(calibration, lag_us=lag_us)


def with_lens(calibration: Calibration, pitch_mm: float, *, staggered: bool = False) -> Calibration:
    """Return a calibration with its lens, or with the reason why there is none in its provenance.

    Args:
        calibration: Of a flat grid.
        pitch_mm: Distance of neighbouring markers on the skin, mm.
        staggered: Whether every second row is shifted, so that columns are not straight.
    """
    rest_px, grid = calibration.reference_px, calibration.grid
    try:
        if grid is None or staggered:
            raise CalibrationError("without rows and columns nothing is known to be even")
        lens = fit_lens(rest_px, grid, calibration.size, pitch_mm, calibration.marker_measured)
    except CalibrationError as error:
        return replace(calibration, provenance={**calibration.provenance, "no_lens": str(error)})
    return replace(calibration, lens=lens)
