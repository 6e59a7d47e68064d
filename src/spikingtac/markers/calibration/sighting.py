"""Where the markers are seen at rest, and whether they are markers at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.markers.blobs import BlobConfig, BlobDetector, Blobs
from spikingtac.markers.calibration.buffered_events import BufferedEvents, with_support
from spikingtac.markers.calibration.lattice import LayoutKind
from spikingtac.markers.calibration.layout import Layout, find_layout
from spikingtac.markers.calibration.level_maps import (
    MeanSteps,
    level_maps,
    mean_steps,
    starting_levels,
)
from spikingtac.markers.calibration.rests import (
    find_rests,
    moving_events,
    unloaded_rests,
)

SMOOTH_PX = 1.0
"""Width of the Gaussian that takes single pixels' noise off before blobs are looked for."""

AREA_SHARES = (0.25, 3.0)
"""Blobs of a smaller or larger share of the median area are no markers, or two."""

CANDIDATES = BlobConfig(threshold=0.45, min_area_px=12.0, max_area_px=20_000.0)
"""Spots of the smoothed map that may be markers: radii of 2 px and more. Blur takes a little off
the level of small discs, so that the threshold is below one half."""

FEWEST_MARKERS = 3
"""Fewer markers are no grid."""


MOST_STRAY_SHARE = 0.5
"""Blobs that fit into no grid, as a share of those that do, above which there is no grid."""


HAZE_EVENTS = 1.0
"""Events of noise of a pixel over the recording from which a second look leaves lone events out
(ours): their steps add up to a haze, in which pale markers are lost. (Not at the first look: where
markers are seen nevertheless, they are led astray by what is left out of slow motions.)"""

EVEN_LOOKS = 16
"""Looks at regular times where a recording has no rest."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """The markers as they are seen at rest.

    Attributes:
        layout: Which blob is which marker.
        center_px: ``(m, 2)`` where each marker was seen; missing ones: is expected.
        stray_px: ``(k, 2)`` where blobs are that belong to no marker.
        radius_px: Typical radius of the markers, px.
    """

    layout: Layout
    center_px: NDArray[np.float64]
    stray_px: NDArray[np.float64]
    radius_px: float


@dataclass(frozen=True, kw_only=True, slots=True)
class FindingConfig:
    """What is known of the markers before they are looked for.

    Attributes:
        grid: ``(rows, columns)``, or None to find it.
        layout: What the markers are; "auto" tells grids from staggered rows.
        polarity: White markers on dark ground, dark on light, or "auto" to find out.
    """

    grid: tuple[int, int] | None = None
    layout: LayoutKind = "auto"
    polarity: Literal["auto", "white", "dark"] = "auto"

    def __post_init__(self) -> None:
        if self.grid is not None and min(self.grid) < 1:
            raise ConfigError(f"grid is {self.grid}, rows and columns must be positive")
        if self.grid is not None and self.layout == "free":
            raise ConfigError("a free layout has no rows and columns; give no grid")


@dataclass(frozen=True, slots=True)
class Look:
    """A recording and what its maps at rest showed.

    Attributes:
        events: The recording, markers brighter than the ground.
        polarity: ``"white"`` or ``"dark"`` markers.
        steps: What an event stands for on the average.
        rests_us: ``(rests, 2)`` when the skin rested, us since the start.
        unloaded: ``bool[rests]`` at which of them nothing touched it.
        maps: ``(rests, height, width)`` levels 0 to 1.
        sighting: The grid.
    """

    events: BufferedEvents
    polarity: str
    steps: MeanSteps
    rests_us: NDArray[np.int64]
    unloaded: NDArray[np.bool_]
    maps: NDArray[np.float32]
    sighting: Sighting

    @property
    def length_us(self) -> NDArray[np.int64]:
        """``(rests,)`` how long each rest lasts, us."""
        return np.diff(self.rests_us, axis=1)[:, 0]

    def noise(self, reach_px: float) -> NDArray[np.float64]:
        """Return ON and OFF events within a reach over the recording, as the silence has them."""
        silent = ~moving_events(self.events, self.rests_us)
        silence_us = float(np.diff(self.rests_us, axis=1).sum())
        if not len(self.rests_us) or silent.all():
            return np.zeros(2)
        on = np.count_nonzero(self.events.code[silent] & 1)
        counts = np.array([on, np.count_nonzero(silent) - on], float)
        share = np.pi * reach_px**2 / self.events.pixels
        return counts * share * self.events.duration_us / max(silence_us, 1.0)


def look_at(events: BufferedEvents, config: FindingConfig, known: Sighting | None = None) -> Look:
    """Find out polarity, rests and grid of a recording.

    Args:
        events: The recording.
        config: What is known beforehand.
        known: Where the markers are, where they need not be found.

    Raises:
        CalibrationError: There are no markers.
    """
    rests_us = find_rests(events)
    try:
        return _look((events, events), rests_us, config, known)
    except CalibrationError:
        if _noise_events(events, rests_us) < HAZE_EVENTS:
            raise
    return _look((events, with_support(events)), rests_us, config, known)


def _look(
    read: tuple[BufferedEvents, BufferedEvents],
    rests_us: NDArray[np.int64],
    config: FindingConfig,
    known: Sighting | None,
) -> Look:
    """Look at some of the events, the second ones of ``read``; see :func:`look_at`."""
    events, shown = read
    steps = mean_steps(shown, moving_events(shown, rests_us))
    looks_us = rests_us
    if not len(rests_us):
        edges_us = np.linspace(0, events.duration_us, EVEN_LOOKS + 1).astype(np.int64)
        looks_us = np.column_stack([edges_us[:-1], edges_us[1:]])
    index = shown.index_at(looks_us.mean(axis=1).astype(np.int64))
    views = {}
    for polarity in ("white", "dark"):
        seen = shown if polarity == "white" else shown.inverted()
        mean = steps if polarity == "white" else steps.inverted()
        if config.polarity in ("auto", polarity):
            start = starting_levels(seen, rests_us, mean)
            views[polarity] = (mean, level_maps(seen, mean, index, start))
    polarity = min(views, key=lambda name: lit_share(views[name][1]))
    mean, maps = views[polarity]
    seen = events if polarity == "white" else events.inverted()
    length_us = np.diff(looks_us, axis=1)[:, 0]
    unloaded = unloaded_rests(maps, length_us)
    level = np.average(maps[unloaded], axis=0, weights=length_us[unloaded])
    sighting = known or sight_markers(level.astype(np.float32), events.size, config)
    return Look(seen, polarity, mean, looks_us, unloaded, maps, sighting)


def _noise_events(events: BufferedEvents, rests_us: NDArray[np.int64]) -> float:
    """Return how many events of noise a pixel sends over the recording, as the rests tell."""
    silence_us = float(np.diff(rests_us, axis=1).sum())
    silent = np.count_nonzero(~moving_events(events, rests_us))
    return silent / events.pixels * events.duration_us / silence_us if silence_us else 0.0


def lit_share(maps: NDArray[np.float32]) -> float:
    """Return which share of the pixels shows a marker, on the average over maps.

    Of the two polarities the right one shows the fewer: discs, and not what they passed.
    """
    smooth = [_smoothed(level) > 0.5 for level in maps]
    return float(np.mean(smooth))


def _smoothed(level: NDArray[np.float32]) -> NDArray[np.float32]:
    # A late import: every verb's start would wait for it.
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(level, SMOOTH_PX), np.float32)


def sight_markers(
    level: NDArray[np.float32], size: tuple[int, int], config: FindingConfig
) -> Sighting:
    """Find the markers in a map of the skin at rest.

    Args:
        level: ``(height, width)`` mean of the maps at rest.
        size: ``(width, height)``.
        config: What is known beforehand.

    Raises:
        CalibrationError: No markers are there; says what was seen instead.
    """
    seen = BlobDetector(size, CANDIDATES).detect(_smoothed(level))
    found = _alike(seen)
    if len(found) < FEWEST_MARKERS:
        raise CalibrationError(
            f"no grid of markers: {len(found)} spots of equal size appeared where a grid has at "
            f"least {FEWEST_MARKERS}; record the sensor while something presses or slides on all "
            "of its skin, so that every marker moves by more than its diameter"
        )
    layout = find_layout(found.center_px, size, config.grid, config.layout)
    there = layout.point >= 0
    count = int(there.sum())
    fits = layout.fits is not None
    if count < FEWEST_MARKERS or (len(layout.stray) > MOST_STRAY_SHARE * count and not fits):
        raise CalibrationError(
            f"no grid of markers: of {len(found)} spots only {count} lie in rows and columns; "
            "the recording seems to show something else than a marker sensor. If its markers lie "
            "in no rows, give --layout free"
        )
    center_px = layout.expected_px.copy()
    center_px[there] = found.center_px[layout.point[there]]
    whole = found.area_px[~found.cut] if (~found.cut).any() else found.area_px
    radius_px = float(np.sqrt(np.median(whole) / np.pi))
    return Sighting(layout, center_px, found.center_px[layout.stray], radius_px)


def _alike(blobs: Blobs) -> Blobs:
    whole = blobs.area_px[~blobs.cut] if (~blobs.cut).any() else blobs.area_px
    usual = float(np.median(whole)) if len(whole) else 0.0
    least, most = (share * usual for share in AREA_SHARES)
    keep = (blobs.area_px >= least) & (blobs.area_px <= most)
    return Blobs(blobs.center_px[keep], blobs.area_px[keep], blobs.mass[keep], blobs.cut[keep])
