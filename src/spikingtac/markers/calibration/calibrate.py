"""Calibrate a sensor from bootstrap slides, beginning with an empty map (section IV-D, and ours).

Runs of events give each pixel's step; the map that they build shows the markers; the grid is found
in them; they are followed back to the beginning and forth again; what both directions show at rest
is averaged, since their errors from lag and hysteresis are opposed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.source import EventSource
from spikingtac.markers.calibration.candidates import Sighting, missing_markers_text, sight_markers
from spikingtac.markers.calibration.contrast_steps import ContrastSteps, StepConfig, learn_steps
from spikingtac.markers.calibration.marker_course import FEWEST_AGREEMENT
from spikingtac.markers.calibration.reference import Method, mean_pitch_px, reference
from spikingtac.markers.calibration.rest import RestConfig, find_rests
from spikingtac.markers.calibration.rest_course import RestCourse, watch_rests
from spikingtac.markers.calibration.slides import buffer_slides
from spikingtac.markers.lag.recording_lag import slide_lag_us
from spikingtac.markers.profile import EDGE_DEFAULT_PX, DiscProfile
from spikingtac.markers.published.blobs import BlobConfig

LagEstimator = Callable[[EventSource, Calibration], float | None]
"""Learns ``lag_us`` from the recording and the calibration so far; None where it cannot."""

CONTRASTS = (1.2, 100.0)
"""Least and largest contrast that the steps may stand for."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationConfig:
    """What the calibration may be told; nothing needs to be.

    Attributes:
        grid: ``(rows, columns)``, or None to find it.
        pitch_mm: Distance of neighbouring markers on the skin, mm, for ``px_per_mm``.
        polarity: White markers on dark ground, or dark on light.
        method: How rests become a reference (:mod:`spikingtac.markers.calibration.reference`).
        allow_missing: So many markers may be missing (broken ones): they are put where their
            neighbours expect them, and named in ``provenance``.
        threshold: Contrast threshold of the camera, log intensity. Only the product of steps and
            contrast can be learnt from events, so it sets the scale of ``contrast``; 0.25 is the
            usual setting, and a wrong one shifts radii by some 0.1 px.
        sample_us: Time between positions; 10 ms move a marker by less than its edge is wide.
        most_events: Bound of the memory: 8 bytes each.
        steps: How full swings are told.
        rest: How silence is told.
        blobs: What counts as a candidate.
    """

    grid: tuple[int, int] | None = None
    pitch_mm: float | None = None
    polarity: Literal["white", "dark"] = "white"
    method: Method = "rest-mean"
    allow_missing: int = 0
    threshold: float = 0.25
    sample_us: int = 10_000
    most_events: int = 100_000_000
    steps: StepConfig = field(default_factory=StepConfig)
    rest: RestConfig = field(default_factory=RestConfig)
    blobs: BlobConfig = field(default_factory=lambda: BlobConfig(max_area_px=20_000.0))

    def __post_init__(self) -> None:
        if self.grid is not None and min(self.grid) < 1:
            raise ConfigError(f"grid is {self.grid}, rows and columns must be positive")
        if self.pitch_mm is not None and not self.pitch_mm > 0.0:
            raise ConfigError(f"pitch_mm is {self.pitch_mm}, it must be positive")
        if self.sample_us < 1 or self.allow_missing < 0 or not self.threshold > 0.0:
            raise ConfigError(
                f"sample_us {self.sample_us} and threshold {self.threshold} must be positive, "
                f"allow_missing {self.allow_missing} not negative"
            )


def calibrate(
    source: EventSource,
    config: CalibrationConfig | None = None,
    estimate_lag: LagEstimator | None = slide_lag_us,
) -> Calibration:
    """Learn a sensor's calibration from a recording of slides.

    Args:
        source: The recording; it is read once (again by ``estimate_lag``, if that is given).
        config: What is known beforehand.
        estimate_lag: Fills in ``lag_us`` at the end; None leaves it unknown.

    Raises:
        CalibrationError: Markers are missing, or the recording has no slides or rests; says which,
            where, and what to do.
    """
    config = config or CalibrationConfig()
    slides = buffer_slides(source, config.most_events)
    if config.polarity == "dark":
        slides = slides.inverted()
    steps = learn_steps(slides, config.steps)
    rests_us = find_rests(slides, config.rest)
    sighting = sight_markers(slides, steps, rests_us, config.blobs, config.grid)
    gaps = sighting.grid.missing
    if len(gaps) > config.allow_missing:
        raise CalibrationError(missing_markers_text(sighting.grid, slides.size))
    start = DiscProfile(contrast_of(steps, config.threshold), EDGE_DEFAULT_PX)
    rests = watch_rests(slides, steps, rests_us, sighting, (start, config.sample_us))
    calibration = _assembled(steps, rests, sighting, config)
    lag_us = estimate_lag(source, calibration) if estimate_lag else None
    return calibration if lag_us is None else replace(calibration, lag_us=lag_us)


def contrast_of(steps: ContrastSteps, threshold: float) -> float:
    """Return marker over ground intensity that mean steps and a threshold (log) stand for."""
    mean = 0.5 * (steps.mean_on + steps.mean_off)
    return float(np.exp(threshold / mean).clip(*CONTRASTS))


def _assembled(
    steps: ContrastSteps, rests: RestCourse, sighting: Sighting, config: CalibrationConfig
) -> Calibration:
    shape = sighting.grid.shape
    place = _Places(sighting, rests.marker)
    reference_px = place.positions(reference(rests.position_px, config.method))
    radius_px = place.values(rests.fit.radius_px, float(np.median(rests.fit.radius_px)))
    scale = None
    if config.pitch_mm is not None and len(reference_px) > 1:
        scale = mean_pitch_px(reference_px, shape) / config.pitch_mm
    return Calibration(
        reference_px=reference_px,
        radius_px=radius_px,
        grid=shape,
        size=(steps.on.shape[1], steps.on.shape[0]),
        polarity=config.polarity,
        step_on=steps.mean_on,
        step_off=steps.mean_off,
        step_on_map=steps.on,
        step_off_map=steps.off,
        contrast=rests.fit.profile.contrast,
        edge_px=rests.fit.profile.edge_px,
        px_per_mm=scale,
        provenance={
            "method": config.method,
            "unloaded_rests_us": rests.span_us.tolist(),
            "missing": sighting.grid.missing.tolist(),
            "unsteady": rests.marker[rests.agreement < FEWEST_AGREEMENT].tolist(),
            "swings": np.round(_swings(steps, reference_px, radius_px), 1).tolist(),
            "residual": np.round(place.values(rests.fit.residual, 1.0), 4).tolist(),
            "scatter_px": np.round(place.values(rests.scatter_px, 0.0), 4).tolist(),
        },
    )


class _Places:
    """Puts values of the markers that were followed into arrays of all markers."""

    def __init__(self, sighting: Sighting, marker: NDArray[np.int64]) -> None:
        self._sighting, self._marker = sighting, marker

    def values(self, values: NDArray[np.float64], other: float) -> NDArray[np.float64]:
        out = np.full(len(self._sighting.center_px), other)
        out[self._marker] = values
        return out

    def positions(self, position_px: NDArray[np.float64]) -> NDArray[np.float64]:
        # Missing markers keep their distance to the others' mean shift since the sighting.
        seen_px = self._sighting.center_px
        out = seen_px + np.median(position_px - seen_px[self._marker], axis=0)
        out[self._marker] = position_px
        return out


def _swings(
    steps: ContrastSteps, reference_px: NDArray[np.float64], radius_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    # Mean full swings per pixel of each marker's disc: how well its steps are known.
    disc = paint_labels((steps.on.shape[1], steps.on.shape[0]), reference_px, radius_px)
    markers = len(reference_px)
    pixels = np.bincount(disc.ravel(), minlength=markers + 1)
    total = np.bincount(disc.ravel(), steps.swings.ravel(), minlength=markers + 1)
    return total[1:] / np.maximum(pixels[1:], 1)


def paint_labels(
    size: tuple[int, int], reference_px: NDArray[np.float64], radius_px: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return ``(height, width)`` with each disc's pixels numbered from 1, 0 on the ground."""
    out = np.zeros((size[1], size[0]), np.int64)
    y, x = np.ogrid[: size[1], : size[0]]
    for number, ((cx, cy), radius) in enumerate(zip(reference_px, radius_px, strict=True), start=1):
        out[(x - cx) ** 2 + (y - cy) ** 2 <= radius**2] = number
    return out
