"""Calibrate a sensor from any recording in which its markers move (section IV-D, and ours).

The balance of ON and OFF events tells what one of them stands for; the maps at rest show the
markers; the grid is found in them; the markers are followed through the recording; and places,
radii, edges and steps are refined until ideal pixels fire what the real ones fired. Slides are
motion like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from spikingtac.calibration.lens import fit_lens
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.source import EventSource, refuse_path
from spikingtac.markers.calibration.assembled import assembled, cells, within_sight
from spikingtac.markers.calibration.disc_levels import REACH_EDGES, Discs
from spikingtac.markers.calibration.find_markers import (
    FindingConfig,
    Overview,
    SeenMarkers,
    look_over,
)
from spikingtac.markers.calibration.first_course import choose_samples, first_course
from spikingtac.markers.calibration.layout import Layout
from spikingtac.markers.calibration.quality import (
    judge,
    level_changes,
    refuse_gaps,
    refuse_without_grid,
)
from spikingtac.markers.calibration.recording import buffer_events, without_hot_pixels
from spikingtac.markers.calibration.recovery import with_recovery
from spikingtac.markers.calibration.reference import (
    Method,
)
from spikingtac.markers.calibration.refine import Refined, choose_states, refine
from spikingtac.markers.calibration.swings import LearnedSteps
from spikingtac.markers.lag import slide_lag_us

# Learns ``lag_us`` from the recording and the calibration so far; None where it cannot.
LagEstimator = Callable[[EventSource, Calibration], float | None]

CONTRASTS = (1.3, 12.0)  # Least and largest contrast that the steps may stand for.

# Edge width and contrast from which the refinement begins.
FIRST_EDGE_PX, FIRST_CONTRAST = 0.8, 3.3

# Radius from which it begins, as a share of that of the blobs, which the blur makes larger.
FIRST_RADIUS_SHARE = 0.95


# Contrast threshold of a camera at usual settings, log intensity. Only the product of steps and
# contrast can be learnt from events, so it sets the scale of ``contrast``; a wrong one shifts
# radii by some 0.1 px.
THRESHOLD = 0.25

# Beginning of a recording from which a calibration by hand is completed, us: a few contacts.
FIRST_US = 15_000_000


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
    look = look_over(events, config)
    calibration = within_sight(_learned(look, config))
    if config.pitch_mm is not None and len(calibration.radius_px) > 1:
        calibration = calibration.with_pitch(config.pitch_mm)
        if config.lens:
            staggered = look.markers.layout.staggered
            calibration = with_lens(calibration, config.pitch_mm, staggered=staggered)
    return _with_lag(replace(calibration, hot_px=hot_px), look, estimate_lag)


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
        look = look_over(events, config, given)
        learned = _with_lag(_learned(look, config), look, slide_lag_us)
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


def _learned(look: Overview, config: CalibrationConfig) -> Calibration:
    refined, learned = _explained(look)
    noise = look.noise(_reach_px(refined.discs))
    quality = judge(level_changes(look.events, refined), refined.events, noise)
    refuse_without_grid(quality)
    layout = look.markers.layout
    if layout.shape is not None:
        missing = np.flatnonzero(~quality.measured)
        refuse_gaps(layout, look.events.size, missing, config.allow_missing)
    return assembled(look, (refined, learned), quality, config.method)


def _with_lag(
    calibration: Calibration, look: Overview, estimate_lag: LagEstimator | None
) -> Calibration:
    seen = look.events if look.polarity == "white" else look.events.inverted()
    lag_us = estimate_lag(seen, calibration) if estimate_lag else None
    return calibration if lag_us is None else replace(calibration, lag_us=lag_us)


def _explained(look: Overview) -> tuple[Refined, LearnedSteps]:
    events, markers = look.events, len(look.markers.center_px)
    index, still = choose_samples(look)
    discs = Discs(
        np.full(markers, FIRST_RADIUS_SHARE * look.markers.radius_px),
        np.full(markers, FIRST_EDGE_PX),
        np.full(markers, FIRST_CONTRAST),
    )
    course, learned = first_course(look, index, still, discs)
    step = np.sqrt(learned.on * learned.off)
    discs = replace(discs, contrast=np.exp(THRESHOLD / step).clip(*CONTRASTS))
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
    about = still, cells(look), look.noise(_reach_px(discs))
    return with_recovery(events, refine(events, start, *about), *about), learned


def _reach_px(discs: Discs) -> float:
    return float(np.median(discs.radius_px + REACH_EDGES * discs.edge_px))


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
