"""Detection of the markers in maps of the skin at rest: discs of equal size, in rows or free."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.events.filters import BackgroundActivityFilter
from spikingtac.events.source import PacketSource
from spikingtac.markers.blobs import find_blobs
from spikingtac.markers.calibration.lattice import LayoutKind
from spikingtac.markers.calibration.layout import Layout, find_layout
from spikingtac.markers.calibration.level_maps import level_maps, mean_steps, starting_levels
from spikingtac.markers.calibration.recording import (
    find_rests,
    inverted,
    moving_events,
    noise_rates,
    smoothed,
    unloaded_rests,
)
from spikingtac.markers.calibration.reference import Method
from spikingtac.schema import convert_fields
from spikingtac.types import EventPacket, FloatArray, Polarity

# Bounds of a marker's area, as shares of the median: smaller spots are none, larger ones two.
AREA_SHARES = (0.25, 3.0)

# Roundness below which a spot shows only a part of its marker. (Two random sensors: parts have up
# to 0.72, and centroids that are off by 4 to 6 px; whole discs have 0.83 and more.)
LEAST_ROUND = 0.75

# Outer radius of the template's dark ring, in marker radii: neighbours that nearly touch begin
# there. (On the two sensors 1.6 completes all twenty spots, 1.4 leaves three, 1.9 most. Without the
# template one marker of each of two simulated slides is calibrated 5 px off; put where the lattice
# expects it, one of them still 3 px.)
RING = 1.6

# Level and areas of spots of the smoothed map that may be markers: radii of 2 px and more. Blur
# lowers the level of small discs a little, so the threshold is below one half.
CANDIDATE_LEVEL, CANDIDATE_PX = 0.45, (12.0, 20_000.0)

FEWEST_MARKERS = 3  # Fewer markers are no grid.
LONGEST_SIDE = 256  # Most rows or columns: of a megapixel, each would have 3 px.

# Largest number of spots beside the grid, as a share of the spots in it.
MOST_STRAY_SHARE = 0.5

# Noise events per pixel over the recording from which isolated events are left out: their steps add
# up to a haze that hides markers. (With them three of ten contacts on the noisy twin were refused,
# and four calibrated with wrong positions. Where noise is rarer, isolated events of slow motions
# are needed; eleven simulated scenes with 1 to 2 events show all of their markers.)
HAZE_EVENTS = 2.5

EVEN_MAPS = 16  # Maps at regular times where a recording has no rest.


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationConfig:
    """What is known of a sensor beforehand; every field has a default.

    Attributes:
        grid: ``(rows, columns)``, or None to find it.
        layout: What the markers are; "auto" tells grids from staggered rows.
        polarity: White markers on dark ground, dark on light, or "auto" to find out.
        pitch_mm: Distance of neighbouring markers on the skin, mm, for ``px_per_mm``.
        lens: Whether to fit a lens to the grid, which must be flat and needs ``pitch_mm``.
        method: How rests become a reference
            (:mod:`spikingtac.markers.calibration.reference`).
        allow_missing: So many markers may be missing, and are named: those without any event stand
            where the others expect them. None allows a third.
    """

    grid: tuple[int, int] | None = None
    layout: LayoutKind = "auto"
    polarity: Literal["auto", Polarity] = "auto"
    pitch_mm: float | None = None
    lens: bool = False
    method: Method = "rest-mean"
    allow_missing: int | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        if self.grid is not None and not 1 <= min(self.grid) <= max(self.grid) <= LONGEST_SIDE:
            raise ConfigError(f"grid is {self.grid}, valid are 1 to {LONGEST_SIDE} rows, columns")
        if self.grid is not None and self.layout == "free":
            raise ConfigError("a free layout has no rows and columns; give no grid")
        if self.pitch_mm is not None and not self.pitch_mm > 0.0:
            raise ConfigError(f"pitch_mm is {self.pitch_mm}, it must be positive")
        if self.lens and self.pitch_mm is None:
            raise ConfigError("the lens is fitted to a grid of known pitch; give pitch_mm, too")
        if self.allow_missing is not None and self.allow_missing < 0:
            raise ConfigError(f"allow_missing is {self.allow_missing}, it must not be negative")


@dataclass(frozen=True, slots=True)
class DetectedMarkers:
    """The markers as detected at rest.

    Attributes:
        layout: Assignment of spots to markers.
        center_px: ``(m, 2)`` detected position of each marker, or the expected one if missing, px.
        stray_px: ``(k, 2)`` spots that belong to no marker, px.
        radius_px: Typical radius of the markers, px.
    """

    layout: Layout
    center_px: FloatArray
    stray_px: FloatArray
    radius_px: float


@dataclass(frozen=True, slots=True)
class Overview:
    """A recording, with its polarity, rests and markers.

    Attributes:
        events: The recording, markers brighter than the ground.
        polarity: White or dark markers.
        steps: ``(2,)`` mean steps of an ON and an OFF event, shares of a full swing.
        rests_us: ``(rests, 2)`` begin and end of each rest, us.
        unloaded: ``bool[rests]`` rests without contact.
        markers: The detected markers.
    """

    events: EventPacket
    polarity: Polarity
    steps: NDArray[np.float32]
    rests_us: NDArray[np.int64]
    unloaded: NDArray[np.bool_]
    markers: DetectedMarkers

    @property
    def recorded(self) -> PacketSource:
        """The events with the polarities of the recording."""
        events = self.events if self.polarity == "white" else inverted(self.events)
        return PacketSource([events], events.size)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The recording to which a model is fitted, and its samples.

    Attributes:
        events: The recording, markers brighter than the ground.
        index: ``(n,)`` number of events before each sample.
        states: ``(k,)`` samples at which real and ideal pixels are compared.
        rests: ``(rests,)`` the sample of each rest.
        cell: ``(pixels,)`` nearest marker of each pixel.
        noise_hz_px: ``(2,)`` rates of ON and OFF noise, Hz/px.
        loss: Share of the events that was lost.
    """

    events: EventPacket
    index: NDArray[np.int64]
    states: NDArray[np.int64]
    rests: NDArray[np.int64]
    cell: NDArray[np.int64]
    noise_hz_px: FloatArray
    loss: float


def survey(
    events: EventPacket, config: CalibrationConfig, known: DetectedMarkers | None = None
) -> Overview:
    """Detect polarity, rests and markers of a recording.

    Args:
        events: The recording.
        config: Prior knowledge of the sensor.
        known: The markers, if they need no detection.

    Raises:
        CalibrationError: There are no markers.
    """
    spans_us = rests_us = find_rests(events)
    start_us, end_us = events.t_start_us, events.t_end_us
    noise = noise_rates(events, rests_us) * 1e-6
    hazy = noise.sum() * (end_us - start_us) >= HAZE_EVENTS
    shown = BackgroundActivityFilter(events.size)(events) if hazy else events
    moving_us = end_us - start_us - np.diff(rests_us, axis=1).sum()
    steps = mean_steps(events, moving_events(events, rests_us), noise * moving_us * events.pixels)
    if not len(rests_us):
        edges_us = np.linspace(start_us, end_us, EVEN_MAPS + 1).astype(np.int64)
        spans_us = np.column_stack([edges_us[:-1], edges_us[1:]])
    index = shown.t.searchsorted(spans_us.mean(axis=1).astype(np.int64))
    views = {}
    for polarity in get_args(Polarity) if config.polarity == "auto" else (config.polarity,):
        swapped = inverted(shown), steps[::-1].copy()
        seen, mean = (shown, steps) if polarity == "white" else swapped
        maps = level_maps(seen, mean, index, starting_levels(seen, rests_us, mean))
        views[polarity] = seen, mean, maps
    polarity = min(views, key=lambda name: sum(map(clutter, views[name][2])))
    seen, steps, maps = views[polarity]
    length_us = np.diff(spans_us, axis=1)[:, 0]
    unloaded = unloaded_rests(maps, length_us)
    level = np.average(maps[unloaded], axis=0, weights=length_us[unloaded]).astype(np.float32)
    signed = level_maps(seen, steps, index[unloaded], np.full(events.shape, 0.5, np.float32))
    markers = known or detect_markers(level, config, signed.mean(axis=0) - 0.5)
    events = events if polarity == "white" else inverted(events)
    return Overview(events, polarity, steps, spans_us, unloaded, markers)


def clutter(level: NDArray[np.float32]) -> float:
    """Return a measure of how little a map looks like discs: its bright area over its roundness.

    The right polarity shows fewer and rounder spots: the discs, and not the area that they swept.
    (Markers that move by less than their diameter sweep less than they cover.)
    """
    spots = find_blobs(smoothed(level), areas_px=(1.0, np.inf))
    return float(spots.area_px.sum() ** 2 / max(spots.area_px @ spots.roundness, 1e-9))


def detect_markers(
    level: NDArray[np.float32], config: CalibrationConfig, signed: NDArray[np.float32] | None = None
) -> DetectedMarkers:
    """Detect the markers in a map ``(height, width)`` of the skin at rest.

    Args:
        level: The map.
        config: Prior knowledge of the sensor.
        signed: The same map from -0.5 to 0.5, 0 where events do not determine the level. With it,
            spots that show only a part of their marker, which moved by less than its diameter to
            one side, are relocated by template matching.

    Raises:
        CalibrationError: There are no markers; says what was seen instead.
    """
    size = level.shape[1], level.shape[0]
    spots = find_blobs(smoothed(level), CANDIDATE_LEVEL, CANDIDATE_PX)
    whole = spots.area_px[~spots.cut] if (~spots.cut).any() else spots.area_px
    usual = float(np.median(whole)) if len(whole) else 0.0
    alike = (spots.area_px >= AREA_SHARES[0] * usual) & (spots.area_px <= AREA_SHARES[1] * usual)
    center_px = spots.center_px[alike]
    if len(center_px) < FEWEST_MARKERS:
        raise CalibrationError(
            f"no grid of markers: {len(center_px)} spots of equal size appeared where a grid has "
            f"at least {FEWEST_MARKERS}; record the sensor while something presses or slides on "
            "all of its skin, so that every marker moves by more than its diameter"
        )
    uncut = alike & ~spots.cut
    radius_px = float(np.sqrt(np.median(spots.area_px[uncut if uncut.any() else alike]) / np.pi))
    partial = (uncut & (spots.roundness < LEAST_ROUND))[alike]
    if signed is not None and partial.any():
        center_px[partial] = _matched(center_px[partial], radius_px, signed)
    layout = find_layout(center_px, size, config.grid, config.layout)
    seen = layout.point >= 0
    count, stray = int(seen.sum()), len(layout.stray)
    few = count < FEWEST_MARKERS or stray > MOST_STRAY_SHARE * count
    # Of a requested part of the grid, its other lines may be reflections.
    if layout.fits and config.grid and (few or np.any(np.less(layout.fits, config.grid))):
        raise CalibrationError(
            f"another grid fits all that moves: give --grid {'x'.join(map(str, layout.fits))}"
        )
    if few:
        raise CalibrationError(
            f"no grid of markers: of {len(center_px)} spots only {count} lie in rows and columns; "
            "its markers hardly moved (they must by more than their diameter), noise hides them "
            "(add light, raise the thresholds), or it shows something else than a marker sensor. "
            "If its markers lie in no rows, give --layout free"
        )
    place_px = layout.expected_px.copy()
    place_px[seen] = center_px[layout.point[seen]]
    return DetectedMarkers(layout, place_px, center_px[layout.stray], radius_px)


def _matched(spot_px: FloatArray, radius_px: float, signed: NDArray[np.float32]) -> FloatArray:
    # Template matching near some spots: a bright disc of that radius with a dark ring around it.
    from scipy.signal import fftconvolve

    reach = int(np.ceil(RING * radius_px))
    away_px = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    disc = np.where(away_px <= radius_px, 1.0, -1.0) * (away_px <= RING * radius_px)
    fit = fftconvolve(signed, disc, "same")
    y, x = np.indices(signed.shape)
    near = [np.hypot(x - column, y - row) <= radius_px for column, row in spot_px]
    best = [np.where(part, fit, -np.inf).argmax() for part in near]
    return np.column_stack([x.ravel()[best], y.ravel()[best]]).astype(np.float64)
