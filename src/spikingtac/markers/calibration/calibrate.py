"""Calibrate a sensor from any recording in which its markers move.

Find the discs in maps of the skin at rest and label their lattice; track them with a first guess;
refine one model of places, discs and steps until ideal pixels fire what the real ones fired; check
how much of the recording it explains. Slides are motion like any other.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import MAPS, MARKER_NUMBERS, MEASURED, OWN
from spikingtac.calibration.lens import fit_lens
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError
from spikingtac.events.source import EventSource, refuse_path
from spikingtac.markers.calibration.find_markers import (
    CalibrationConfig,
    Overview,
    SeenMarkers,
    look_over,
)
from spikingtac.markers.calibration.first_model import STEP_BOUNDS
from spikingtac.markers.calibration.ideal_pixels import Evidence, Model
from spikingtac.markers.calibration.layout import Layout
from spikingtac.markers.calibration.recording import buffer_events, flicker_hz, without_hot_pixels
from spikingtac.markers.calibration.reference import Method, displaced_before, reference
from spikingtac.markers.calibration.refine import Quality, explained
from spikingtac.markers.lag import slide_lag_us

# Learns ``lag_us`` from the recording and the calibration so far; None where it cannot.
LagEstimator = Callable[[EventSource, Calibration], float | None]

# Beginning of a recording from which a calibration by hand is completed, us: a few contacts.
FIRST_US = 15_000_000

# A marker whose centre lies further beyond the border, in radii, is left out: the part in sight,
# less than a fifth of it, does not tell its place.
BEYOND_RADII = 0.5

OF_MARKERS = ("radius_px", *MARKER_NUMBERS, MEASURED)  # What is told of each marker.

# Step above which events are coarse: a swing from ground to marker has hardly two. (Of twenty
# random sensors the four that are err by 1.4 to 3.8 px; the recorded gel has 0.46.)
COARSE_STEP = 0.55

HEARD_EVENTS = 400.0  # Events near a marker, beyond noise, that tell its steps: 2 px of way.

# Share of a pixel's own deviation from its marker's step that the tracker is given: in few swings
# the rim's way counts, too. (Simulated: 2 to 4 % more error without; 0.017 px more with all of it.)
PIXEL_SHARE = 0.3


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
    learned = explained(view, config)
    calibration = replace(_assembled(view, learned, config.method), hot_px=hot_px)
    if config.pitch_mm is not None and len(calibration.radius_px) > 1:
        calibration = calibration.with_pitch(config.pitch_mm)
        if config.lens:
            staggered = view.markers.layout.staggered
            calibration = with_lens(calibration, config.pitch_mm, staggered=staggered)
    return _with_lag(calibration, view, estimate_lag)


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
    radius_px = float(np.median(known.radius_px))
    given = SeenMarkers(layout, place_px, place_px[:0], radius_px, len(place_px))
    config = CalibrationConfig(polarity="dark" if known.polarity == "dark" else "white")
    try:
        events, hot_px = without_hot_pixels(buffer_events(source, FIRST_US))
        view = look_over(events, config, given)
        seen = replace(known, **_looks(*explained(view, config)))
    except CalibrationError:
        return known
    hot_px = hot_px if known.hot_px is None else known.hot_px
    return _with_lag(replace(seen, hot_px=hot_px), view, slide_lag_us)


def _assembled(
    view: Overview, learned: tuple[Evidence, Model, Quality], method: Method
) -> Calibration:
    """Return the calibration that a model stands for.

    Left out are markers beyond the border, with the rows that they leave, and, where there are no
    rows, markers that were not measured: nothing tells their places.
    """
    (evidence, model, quality), layout, size = learned, view.markers.layout, view.events.size
    measured, rests_us = quality.measured, view.rests_us[view.unloaded]
    rest_px = model.center_px[evidence.rests[view.unloaded]]
    at_us = view.events.times_at(evidence.index)
    displaced_px = displaced_before(rests_us, rest_px, at_us, model.center_px)
    reference_px = reference(rest_px, rests_us, displaced_px, method)
    looks = _looks(*learned)
    keep, grid = _in_sight(layout, reference_px, looks["radius_px"], measured, size)
    left_out_px = reference_px[~keep].round(2).tolist()
    coarse = [round(float(step), 2) for step in view.steps if step > COARSE_STEP]
    scatter_px = np.sqrt(((rest_px - reference_px) ** 2).sum(axis=2).mean(axis=0))
    return Calibration(
        reference_px=reference_px[keep],
        grid=grid,
        size=size,
        polarity=view.polarity,
        **{name: value[keep] if name in OF_MARKERS else value for name, value in looks.items()},
        provenance={
            "method": method,
            "unloaded_rests_us": (view.events.t_start_us + rests_us).tolist(),
            "missing": np.flatnonzero(~measured[keep]).tolist(),
            "swings": np.round(model.swings[keep], 1).tolist(),
            "residual": np.round(model.residual[keep], 4).tolist(),
            "scatter_px": np.round(scatter_px[keep], 4).tolist(),
            "quality": "poor" if coarse else quality.word,
            "doubtful": np.flatnonzero(quality.doubtful[keep]).tolist(),
            "explained": np.round(quality.explained[keep], 3).tolist(),
            "events": np.round(quality.events[keep]).astype(int).tolist(),
            "stray_px": view.markers.stray_px.round(1).tolist(),
            "fitting_grid": layout.fits,
            "flicker_hz": flicker_hz(view.events),
            **({"left_out_px": left_out_px} if left_out_px else {}),
            **({"coarse_steps": coarse} if coarse else {}),
        },
    )


def _in_sight(
    layout: Layout,
    place_px: NDArray[np.float64],
    radius_px: NDArray[np.float64],
    measured: NDArray[np.bool_],
    size: tuple[int, int],
) -> tuple[NDArray[np.bool_], tuple[int, int] | None]:
    """Return which markers stay, and their grid: None where it has lost parts of rows."""
    reach_px = BEYOND_RADII * radius_px[:, np.newaxis]
    inside = (place_px >= -reach_px) & (place_px <= np.array(size) - 1 + reach_px)
    if layout.shape is None:
        return inside.all(axis=1) & measured, None
    there: NDArray[np.bool_] = np.reshape(inside.all(axis=1), layout.shape)
    rows, columns = np.any(there, axis=1), np.any(there, axis=0)
    whole = np.all(there[np.ix_(rows, columns)])
    return there.ravel(), (int(rows.sum()), int(columns.sum())) if whole else None


def _looks(evidence: Evidence, model: Model, quality: Quality) -> dict[str, Any]:
    """Return how the markers look and what events stand for, as :class:`Calibration` has it."""
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
    known = {"marker_step_on": measured | heard, "marker_step_off": measured | heard}
    looks: dict[str, Any] = {
        name: np.where(known.get(name, measured), value, usual[name]) for name, value in own.items()
    }
    looks |= {name: usual[f"marker_{name}"] for name in OWN}
    # Pixels without a full swing, and those of markers that were not measured, have no own step.
    of_measured = measured[evidence.cell]
    for name, step, share in zip(MAPS, (model.on, model.off), model.pixel, strict=True):
        single = (step[evidence.cell] * share**PIXEL_SHARE).clip(*STEP_BOUNDS)
        single = np.where(of_measured & (np.abs(share - 1.0) > 1e-9), single, 0.0)
        looks[name] = single.reshape(evidence.events.shape).astype(np.float32)
    return looks | {MEASURED: measured, "recovery_s": model.recovery_s or None}


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
