"""Fit of one model to all events: positions, radii, edges and steps, by Gauss-Newton iterations.

Each iteration simulates ideal pixels along the model's paths and compares their levels with those
of the real pixels (:mod:`.ideal_pixels`). The residual corrects the position and the shape of each
disc by one Gauss-Newton step (:mod:`.corrections`). The share of the level changes that a disc
finally explains measures how well its marker is known.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.corrections import Changes, corrections, rims
from spikingtac.markers.calibration.find_markers import CalibrationConfig, Evidence, Overview
from spikingtac.markers.calibration.first_model import STEP_BOUNDS, first_model, tracked, with_steps
from spikingtac.markers.calibration.ideal_pixels import Comparison, Model, compare
from spikingtac.markers.calibration.layout import refuse_gaps
from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.types import FloatArray

# Most iterations, with steps, and with positions and shapes alone. Wide edges take many iterations:
# they grow by 0.1 px in each.
STEP_ROUNDS, PLACE_ROUNDS = 10, 5

# The iteration ends when most positions and shapes change by less than this.
SETTLED_PX = 0.01

# Relaxation factors of the steps. The pixels' offsets absorb a part of each residual, so that
# positions converge fastest with over-relaxation (1.5 of 1, 1.5 and 2 tried).
PLACE_GAIN, SHAPE_GAIN, COUNT_GAIN = 1.5, 0.8, 0.5

# Bounds of one iteration's change of a position, and of a radius or an edge, px.
LARGEST_MOVE_PX, LARGEST_GROWTH_PX = 1.0, 0.3

LARGEST_STRETCH_PX = 1.0  # Bound of a stretch: the twin's discs, of 6.8 px, have 0.2 px.

# Bounds of an edge width, px. The recorded sensor has 1.3 to 2.3.
EDGE_BOUNDS_PX = (0.3, 3.0)

# Bounds of a radius, as shares of the median radius.
RADIUS_SHARES = (0.5, 1.6)

# Largest correction factor of a step in one iteration.
LARGEST_FACTOR = 1.25

# Prior count of events, so that few events change a step little.
COUNT_PRIOR = 100.0


def refine(evidence: Evidence, model: Model, *, steps: bool = True) -> Model:
    """Return the model after Gauss-Newton iterations; ``steps`` says whether steps change, too."""
    for _ in range(STEP_ROUNDS if steps else PLACE_ROUNDS):
        seen = compare(evidence, model)
        common_px, own_px, residual = corrections(evidence, model, seen)
        model = _correct_positions(evidence.states, model, common_px, own_px)
        growth = SHAPE_GAIN * common_px[:, 2:].clip(-LARGEST_GROWTH_PX, LARGEST_GROWTH_PX)
        radius_px, edge_px = model.discs.radius_px, model.discs.edge_px + growth[:, 1]
        bounds_px = np.multiply(RADIUS_SHARES, np.median(radius_px))
        radius_px = (radius_px + growth[:, 0]).clip(*bounds_px)
        discs = replace(model.discs, radius_px=radius_px, edge_px=edge_px.clip(*EDGE_BOUNDS_PX))
        model = replace(model, discs=discs, residual=residual)
        model = _correct_steps(model, seen) if steps else model
        # Medians: a marker that the recording hardly shows may never settle.
        largest_px = np.abs(own_px[..., :2]).mean(axis=(0, 2)), np.abs(common_px).max(axis=1)
        if max(float(np.median(one)) for one in largest_px) < SETTLED_PX:
            break
    return model


def _correct_positions(
    states: NDArray[np.int64], model: Model, common_px: FloatArray, own_px: FloatArray
) -> Model:
    from scipy.interpolate import make_interp_spline  # 0.1 s that trackers need not wait

    # Corrections of positions and stretches are interpolated linearly between states.
    change = PLACE_GAIN * own_px
    change[..., :2] += common_px[:, :2].clip(-LARGEST_MOVE_PX, LARGEST_MOVE_PX)
    length = np.linalg.norm(change[..., :2], axis=2, keepdims=True)
    change[..., :2] *= np.minimum(1.0, LARGEST_MOVE_PX / np.maximum(length, 1e-9))
    between = make_interp_spline(states, change, k=1)(np.arange(len(model.center_px)))
    stretch_px = (model.stretch_px + between[..., 2:]).clip(-LARGEST_STRETCH_PX, LARGEST_STRETCH_PX)
    return replace(model, center_px=model.center_px + between[..., :2], stretch_px=stretch_px)


def _correct_steps(model: Model, seen: Comparison) -> Model:
    """Return a model with steps corrected by the counts: fewer events mean larger steps."""
    real, ideal = seen.events.clip(0.0) + COUNT_PRIOR
    factor = ((ideal / real) ** COUNT_GAIN).clip(1.0 / LARGEST_FACTOR, LARGEST_FACTOR)
    return replace(model, steps=(model.steps * factor).clip(*STEP_BOUNDS))


# Time constant with which the pixels of some sensors adapt to a darkening without an event, s (the
# counts of the recorded sensor, pixel by pixel and burst by burst: 0.19 to 0.25).
RECOVERY_S = 0.2

# Share of ON events below which no OFF events are missing (the recorded sensor has 0.75, simulated
# sensors that recover 0.68 and 0.72, sensors with equal thresholds 0.51). Noise does not count: a
# leak sends ON events that no OFF events follow. (By it a recording of DVS-Voltmeter's has 0.61,
# and would be taken for recovering: discs a third smaller, an error of 0.32 px instead of 0.10.)
LEAST_ON_SHARE = 0.6

# Share by which residuals must shrink, median over the markers, to accept recovery (the recorded
# sensor 0.10, parts of it 0.05 to 0.15; seven simulated recordings of sensors that do not recover
# grow by up to 0.29, and shrink by 0.04 with noise of 1 Hz/px; four short presses are too few).
RECOVERY_GAIN = 0.05


def with_recovery(evidence: Evidence, model: Model) -> Model:
    """Return the better of two models: with pixels that recover, or without.

    On the recorded sensor a disc that creeps after a press sends ON events at its front and none at
    its back, and a fast fall sends one more OFF event than a slow one. So a pixel that is darker
    than at its last event adapts to it. Then ON and OFF events stand for nearly the same
    step, and OFF events that seem rare are slow motion. The pixels of other sensors do not adapt.
    """
    pixel_s = 1e-6 * evidence.events.pixels * np.ptp(evidence.events.t)
    on, off = np.bincount(evidence.events.p, minlength=2)[::-1] - pixel_s * evidence.noise_hz_px
    if on < LEAST_ON_SHARE * (on + off):
        return model
    model = refine(evidence, model)
    recovering = refine(evidence, replace(model, recovery_s=RECOVERY_S))
    # Per marker: both models explain a marker that hardly moves equally badly.
    seen = model.residual > 0.0
    left_over = recovering.residual[seen] / model.residual[seen]
    return recovering if seen.any() and np.median(left_over) <= 1.0 - RECOVERY_GAIN else model


# Explained share, relative to the median marker, from which a marker with few events counts as
# measured. (The recorded marker that hardly moves has 0.20, or 0.58 where its corner alone is
# calibrated; two of v2e's markers that rest a pixel off 0.41 and 0.50, a well-known one 0.67.)
FEWEST_EXPLAINED_SHARE = 0.6

# Events beyond the noise that a marker needs, and the share of the median over all markers that is
# sufficient.
FEWEST_EVENTS, FEWEST_EVENTS_SHARE = 40.0, 0.25

# Explained share, relative to the median, below which a measured marker is doubtful.
DOUBTFUL_SHARE = 0.5

# Distance of a doubtful marker from where its neighbours tell it, in radii, from which its disc has
# followed something else, such as a glare that moves with the skin. (Two of 36 markers beside a
# simulated glare came to lie 5 and 15 px off. Fourteen other doubtful ones on seven simulated
# sensors, half-rubbed and pale ones among them, stay.)
STRAYED_RADII = 0.5

GRID_EXPLAINED = 0.15  # Median of the explained shares below which there is no grid of discs.

# States over which offsets are averaged here: changes over some presses count, on rims as well.
OFFSET_STATES = 30.0

# Words for the median of the explained shares.
WORDS = ((0.75, "very good"), (0.55, "good"), (0.35, "usable"), (-1.0, "poor"))


@dataclass(frozen=True, slots=True)
class Quality:
    """Goodness of fit of each marker.

    Attributes:
        explained: ``(m,)`` share of the pixels' level changes that the marker's disc explains.
        events: ``(m,)`` events near the marker beyond the sensor's noise.
        measured: ``(m,) bool`` whether the recording locates the marker.
        doubtful: ``(m,) bool`` measured markers that are explained badly.
        word: The quality in a word or two.
    """

    explained: FloatArray
    events: FloatArray
    measured: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]
    word: str


def quality_of(evidence: Evidence, model: Model) -> Quality:
    """Return how well a model explains each marker.

    Raises:
        CalibrationError: Discs on a grid do not explain the events.
    """
    # Without stretch: it would explain a part of any image.
    model = replace(model, stretch_px=np.zeros_like(model.stretch_px))
    seen = compare(evidence, model)
    change, rim = Changes(seen.drawn, OFFSET_STATES, 1.0), rims(evidence, model, seen)
    left_over, whole = (
        rim.squares(change.of(levels), len(model.residual))
        for levels in (seen.measured - seen.expected, seen.measured)
    )
    # What has shrunk below a pixel is no disc, and explains nothing.
    explained = (1.0 - left_over / np.maximum(whole, 1e-9)).clip(-1.0, model.discs.radius_px > 1.0)
    usual = float(np.median(explained))
    if usual < GRID_EXPLAINED:
        raise CalibrationError(
            f"no grid of markers: discs in rows and columns explain {max(usual, 0.0):.0%} of "
            f"what the pixels saw, where a marker sensor gives {GRID_EXPLAINED:.0%} and more. If "
            "this is one, its markers hardly moved: press or slide until they move by more than "
            "their diameter; or a flicker of the light or noise drowns their events: use direct "
            "current, raise the thresholds (biases); otherwise the recording shows something else"
        )
    above = seen.events[0].sum(axis=0)
    busy = above >= FEWEST_EVENTS_SHARE * np.median(above)
    measured = (above >= FEWEST_EVENTS) & (busy | (explained >= FEWEST_EXPLAINED_SHARE * usual))
    usual = float(np.median(explained[measured])) if measured.any() else 0.0
    doubtful = measured & (explained < DOUBTFUL_SHARE * usual)
    word = next(word for least, word in WORDS if usual >= least)
    return Quality(explained, above, measured, doubtful, word)


def with_rest_radii(model: Model, rests: NDArray[np.int64]) -> Model:
    """Return the model with the radii at some samples as the discs' own: touched discs grow."""
    growth_px = np.median(model.stretch_px[rests, :, 0], axis=0)
    discs = replace(model.discs, radius_px=model.discs.radius_px + growth_px)
    stretch_px = model.stretch_px - np.multiply.outer(growth_px, [1.0, 0.0, 0.0])
    return replace(model, discs=discs, stretch_px=stretch_px)


# Rounds of tracking from the rest positions and counting full swings. (Nine simulated touch scenes,
# calibrated from themselves, rest 0.108 px off with 2, 0.100 with 3, 0.097 with 4.)
TRACKING_ROUNDS = 3


def fit_recording(view: Overview, config: CalibrationConfig) -> tuple[Evidence, Model, Quality]:
    """Fit a model to a recording; return the recording, the model and its quality.

    Raises:
        CalibrationError: Discs do not explain it, or too many of the markers hardly moved.
    """
    evidence, model = first_model(view)
    rests = evidence.rests[view.unloaded]
    model = with_recovery(evidence, model)
    # Tracking improves with a map painted at the rest positions. Counts of events depend on steps
    # and paths; full swings, which sharp discs reveal, depend on steps alone. These are counted
    # along refined paths: tracked ones show swings that are none.
    for _ in range(TRACKING_ROUNDS):
        rest_px = np.median(model.center_px[rests], axis=0)
        model = tracked(view, evidence.index, model, rest_px)
        model = with_rest_radii(refine(evidence, model, steps=False), rests)
        if not model.recovery_s:  # recovering pixels send too few events in a swing
            model = with_steps(evidence, model, rest_px)
    model, quality = _without_strays(view, rests, model, quality_of(evidence, model))
    missing = np.flatnonzero(~quality.measured)
    refuse_gaps(view.markers.layout, view.events.size, missing, config.allow_missing)
    return evidence, model, quality


def _without_strays(
    view: Overview, rests: NDArray[np.int64], model: Model, quality: Quality
) -> tuple[Model, Quality]:
    """Put doubtful discs that have left their markers back amid their neighbours, unmeasured."""
    place_px, rest_px = view.markers.layout.expected_px, np.median(model.center_px[rests], axis=0)
    known_px = np.where(quality.doubtful[:, np.newaxis], place_px, rest_px)
    expected_px = Neighbourhood(place_px).expected_px(known_px)
    away_px = np.hypot(*(rest_px - expected_px).T)
    strayed = quality.doubtful & (away_px > STRAYED_RADII * view.markers.radius_px)
    center_px = np.where(strayed[:, np.newaxis], expected_px, model.center_px)
    kept = {name: getattr(quality, name) & ~strayed for name in ("measured", "doubtful")}
    return replace(model, center_px=center_px), replace(quality, **kept)
