"""Calibrate a sensor from any recording in which its markers move.

The markers are detected in maps of the skin at rest and labelled by their lattice, then tracked
with a first model. One model of positions, discs and steps is refined until simulated ideal pixels
fire as the real ones did; the share of the recording that it explains is the calibration's quality.
Presses and slides are equally good motions.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.document import MAPS, MARKER_NUMBERS, MEASURED, OWN
from spikingtac.calibration.lens import fit_lens
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, require_type
from spikingtac.events.source import EventSource, refuse_path
from spikingtac.markers.calibration.find_markers import (
    CalibrationConfig,
    DetectedMarkers,
    Evidence,
    Overview,
    survey,
)
from spikingtac.markers.calibration.first_model import STEP_BOUNDS
from spikingtac.markers.calibration.ideal_pixels import Model
from spikingtac.markers.calibration.layout import Layout
from spikingtac.markers.calibration.recording import (
    buffer_events,
    flicker_hz,
    times_at,
    without_hot_pixels,
)
from spikingtac.markers.calibration.reference import Method, displaced_before, reference
from spikingtac.markers.calibration.refine import Quality, fit_recording
from spikingtac.markers.lag import with_delays
from spikingtac.types import FloatArray

# Length of the recording from which a calibration by hand is completed, us: a few contacts.
FIRST_US = 15_000_000

# Largest distance of a marker's centre beyond the image border, in radii. Of a marker farther out
# less than a fifth is visible, too little to locate it.
BEYOND_RADII = 0.5

PER_MARKER = ("radius_px", *MARKER_NUMBERS, MEASURED)  # Fields with a value for each marker.

# Step above which events are coarse: a swing from ground to marker has hardly two. (Four of twenty
# random sensors are coarse and err by 1.4 to 3.8 px; the recorded gel has 0.46.)
COARSE_STEP = 0.55

LEAST_STEP_EVENTS = 400.0  # Events beyond noise that measure a marker's steps: 2 px of motion.

# Exponent by which a pixel's step, relative to its marker's, is shrunk: in few swings the path of
# the rim biases it. (Simulated: 2 to 4 % more error without pixels' steps; 0.017 px more at 1.)
PIXEL_SHARE = 0.3


def calibrate(
    source: EventSource,
    config: CalibrationConfig | None = None,
    estimate_lag: bool = True,
) -> Calibration:
    """Learn a sensor's calibration from a recording in which its markers move.

    Args:
        source: The recording, or a camera that ends; it is read once.
        config: Prior knowledge of the sensor.
        estimate_lag: Whether ``lag_us`` and ``dead_time_us`` are estimated at the end.

    Raises:
        CalibrationError: The recording shows no grid of markers, or too few of them; says why,
            where, and what to do.
        ConfigError: A path is given instead of a source.
    """
    refuse_path(source)
    config = config or CalibrationConfig()
    require_type(config, CalibrationConfig, "CalibrationConfig(grid=(8, 8))")
    events, hot_px = without_hot_pixels(buffer_events(source))
    view = survey(events, config)
    learned = fit_recording(view, config)
    calibration = replace(_calibration(view, learned, config.method), hot_px=hot_px)
    if config.pitch_mm is not None and len(calibration.radius_px) > 1:
        calibration = calibration.with_pitch(config.pitch_mm)
        if config.lens:
            staggered = view.markers.layout.staggered
            calibration = with_lens(calibration, config.pitch_mm, staggered=staggered)
    return with_delays(view.recorded, calibration) if estimate_lag else calibration


def completed(source: EventSource, known: Calibration) -> Calibration:
    """Complete a calibration that was written by hand from the first seconds of a recording.

    Steps, radii, edges, contrasts and lag are estimated; positions, grid and polarity stay. A
    calibration that holds steps already, or cannot be completed, is returned as it is.

    Args:
        source: The recording; it is read from its beginning.
        known: The calibration.
    """
    if known.step_on is not None or known.marker_step_on is not None:
        return known
    place_px = known.reference_px
    layout = Layout(known.grid, np.arange(len(place_px)), place_px)
    radius_px = float(np.median(known.radius_px))
    given = DetectedMarkers(layout, place_px, place_px[:0], radius_px)
    config = CalibrationConfig(polarity="dark" if known.polarity == "dark" else "white")
    try:
        events, hot_px = without_hot_pixels(buffer_events(source, FIRST_US))
        view = survey(events, config, given)
        seen = replace(known, **_appearance(*fit_recording(view, config)))
    except CalibrationError:
        return known
    hot_px = hot_px if known.hot_px is None else known.hot_px
    return with_delays(view.recorded, replace(seen, hot_px=hot_px))


def _calibration(
    view: Overview, learned: tuple[Evidence, Model, Quality], method: Method
) -> Calibration:
    """Return the calibration that a model describes.

    Markers beyond the border are left out, and rows that so become empty. Without rows, unmeasured
    markers are left out, too: nothing predicts their positions.
    """
    (evidence, model, quality), layout, size = learned, view.markers.layout, view.events.size
    measured, rests_us = quality.measured, view.rests_us[view.unloaded]
    rest_px = model.center_px[evidence.rests[view.unloaded]]
    at_us = times_at(view.events, evidence.index)
    displaced_px = displaced_before(rests_us, rest_px, at_us, model.center_px)
    reference_px = reference(rest_px, rests_us, displaced_px, method)
    fields = _appearance(*learned)
    keep, grid = _in_sight(layout, reference_px, fields["radius_px"], measured, size)
    left_out_px = reference_px[~keep].round(2).tolist()
    coarse = [round(float(step), 2) for step in view.steps if step > COARSE_STEP]
    scatter_px = np.sqrt(((rest_px - reference_px) ** 2).sum(axis=2).mean(axis=0))
    return Calibration(
        reference_px=reference_px[keep],
        grid=grid,
        size=size,
        polarity=view.polarity,
        **{name: value[keep] if name in PER_MARKER else value for name, value in fields.items()},
        provenance={
            "method": method,
            "unloaded_rests_us": rests_us.tolist(),
            "missing": np.flatnonzero(~measured[keep]).tolist(),
            "residual": np.round(model.residual[keep], 4).tolist(),
            "scatter_px": np.round(scatter_px[keep], 4).tolist(),
            "quality": "poor" if coarse else quality.word,
            "doubtful": np.flatnonzero(quality.doubtful[keep]).tolist(),
            "explained": np.round(quality.explained[keep], 3).tolist(),
            "events": np.round(quality.events[keep]).astype(int).tolist(),
            "stray_px": view.markers.stray_px.round(1).tolist(),
            "flicker_hz": flicker_hz(view.events),
            **({"left_out_px": left_out_px} if left_out_px else {}),
            **({"coarse_steps": coarse} if coarse else {}),
            **({"event_loss": round(evidence.loss, 2)} if evidence.loss else {}),
        },
    )


def _in_sight(
    layout: Layout,
    place_px: FloatArray,
    radius_px: FloatArray,
    measured: NDArray[np.bool_],
    size: tuple[int, int],
) -> tuple[NDArray[np.bool_], tuple[int, int] | None]:
    """Return which markers are visible, and their grid: None where rows are incomplete."""
    reach_px = BEYOND_RADII * radius_px[:, np.newaxis]
    inside = (place_px >= -reach_px) & (place_px <= np.array(size) - 1 + reach_px)
    if layout.shape is None:
        return inside.all(axis=1) & measured, None
    there: NDArray[np.bool_] = np.reshape(inside.all(axis=1), layout.shape)
    rows, columns = np.any(there, axis=1), np.any(there, axis=0)
    whole = np.all(there[np.ix_(rows, columns)])
    return there.ravel(), (int(rows.sum()), int(columns.sum())) if whole else None


def _appearance(evidence: Evidence, model: Model, quality: Quality) -> dict[str, Any]:
    """Return the fields of :class:`Calibration` for appearance and steps."""
    # Unmeasured markers get the median, except for steps that enough events measure: with median
    # steps a pale marker would be lost.
    measured, enough = quality.measured, quality.events >= LEAST_STEP_EVENTS
    own = {
        "marker_edge_px": model.discs.edge_px,
        "marker_contrast": model.discs.stated_contrast,
        "marker_step_on": model.steps[0],
        "marker_step_off": model.steps[1],
        "radius_px": model.discs.radius_px,
    }
    usual = {name: float(np.median(value[measured])) for name, value in own.items()}
    known = {"marker_step_on": measured | enough, "marker_step_off": measured | enough}
    fields: dict[str, Any] = {
        name: np.where(known.get(name, measured), value, usual[name]) for name, value in own.items()
    }
    fields |= {name: usual[f"marker_{name}"] for name in OWN}
    # Pixels without a full swing, and pixels of unmeasured markers, have no step of their own.
    of_measured = measured[evidence.cell]
    for name, step, share in zip(MAPS, model.steps, model.pixel, strict=True):
        single = (step[evidence.cell] * share**PIXEL_SHARE).clip(*STEP_BOUNDS)
        single = np.where(of_measured & (np.abs(share - 1.0) > 1e-9), single, 0.0)
        fields[name] = single.reshape(evidence.events.shape).astype(np.float32)
    return fields | {MEASURED: measured, "recovery_s": model.recovery_s or None}


def with_lens(calibration: Calibration, pitch_mm: float, *, staggered: bool = False) -> Calibration:
    """Return a calibration with its lens, or with the reason for its absence in its provenance.

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
