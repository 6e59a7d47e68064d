"""Score denoisers on one recording: excess centroid error, recall, time per step.

The reference is the centroid in the same map without noise, event loss and activity filter. Errors
of the state map itself therefore do not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import Denoiser
from spikingtac.events import BackgroundActivityFilter, open_events
from spikingtac.markers import PROXIMITY_SHARE, blob_areas_px, find_blobs, smallest_spacing_px
from spikingtac.sim import CameraChoice, Scene, SceneSource, load_scene
from spikingtac.state_map import (
    BinaryStateMap,
    GradedStateMap,
    StateMap,
    paint_binary_discs,
    paint_discs,
)
from spikingtac.types import EventPacket
from spikingtac_paper.training.dataset import with_background, with_drops

MapKind = Literal["binary", "graded"]

# Prefix of the names of methods with the event-activity filter before the map.
ACTIVITY = "activity+"


# The typical camera without its noise.
QUIET = CameraChoice(
    preset="typical",
    settings={
        "background": {"rate_hz": 0.0, "hot_fraction": 0.0},
        "pixel": {"leak_hz": 0.0},
    },
)


@dataclass(frozen=True, slots=True)
class CleanRecording:
    """A recording with as little noise as possible.

    Attributes:
        name: Name of the scene or file.
        events: All its events.
        reference_px: ``(m, 2)`` rest positions, from which the first map is painted, px.
        radius_px: ``(m,)`` radii of the markers, px.
        source: ``twin`` or ``v2e``.
        t_us: ``(n,)`` times of the truth, us.
        marker_px: ``(n, m, 2)`` true centres, px.
    """

    name: str
    events: EventPacket
    reference_px: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    source: str
    t_us: NDArray[np.int64]
    marker_px: NDArray[np.float32]

    def true_px(self, t_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the true centres ``(k, m, 2)`` at some times, px; each is that of the next row."""
        rows = np.minimum(np.searchsorted(self.t_us, t_us), len(self.t_us) - 1)
        return self.marker_px[rows].astype(np.float64)


def noise_free(scene: Scene) -> Scene:
    """Return the scene with the typical camera, without its noise."""
    return replace(scene, camera=QUIET)


def render(scene_name: str, seed: int, duration_s: float) -> CleanRecording:
    """Render one recording of the twin without noise, with its truth."""
    source = SceneSource(noise_free(load_scene(scene_name)), seed, duration_s)
    steps = list(source.steps())
    events = EventPacket.concatenate([step.packet for step in steps])
    times_us = np.concatenate([step.truth.marker_t_us for step in steps])
    marker_px = np.concatenate([step.truth.marker_px for step in steps])
    reference_px, radius_px = source.reference_px, source.radius_px
    return CleanRecording(scene_name, events, reference_px, radius_px, "twin", times_us, marker_px)


def open_v2e(folder: str | Path, name: str = "mix") -> CleanRecording:
    """Open a v2e recording; its own noise (0.1 Hz/px) remains in it."""
    source = open_events(Path(folder) / f"{name}.raw")
    events = EventPacket.concatenate([packet for packet in source if len(packet)])
    with np.load(Path(folder) / f"{name}.truth.npz", allow_pickle=False) as truth:
        reference_px = truth["reference_px"].astype(float)
        radius_px = truth["radius_px"].astype(float)
        return CleanRecording(
            name, events, reference_px, radius_px, "v2e", truth["marker_t_us"], truth["marker_px"]
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Degradation:
    """A degradation of the events.

    Attributes:
        noise_hz: Background noise that is added, per pixel and second.
        drop: Fraction of the signal events that is dropped.
        window_us: Window of the activity filter, us.
        seed: Seed of noise and drops.
    """

    noise_hz: float
    drop: float
    window_us: int
    seed: int = 0

    def filtered(self, events: EventPacket) -> EventPacket:
        """Return the events that pass the activity filter."""
        return BackgroundActivityFilter(events.size, self.window_us)(events)

    def apply(self, events: EventPacket) -> EventPacket:
        """Return the degraded events, unfiltered."""
        random = np.random.default_rng(self.seed)
        return with_background(with_drops(events, self.drop, random), self.noise_hz, random)


@dataclass(frozen=True, slots=True)
class Centroids:
    """The reference positions.

    Attributes:
        at_us: ``(n,)`` moments, us.
        center_px: ``(n, m, 2)`` centroids in the clean map, px. Where it does not show a marker as
            one blob (two markers touch, or one lies at the border), the last centroid.
        found: ``(n, m)`` False there; such moments are not scored.
        speed_px_s: ``(n, m)`` speed of each centroid, px/s.
    """

    at_us: NDArray[np.int64]
    center_px: NDArray[np.float64]
    found: NDArray[np.bool_]
    speed_px_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Score:
    """The result of one method on one recording.

    Attributes:
        center_px: ``(n, m, 2)`` centroids of the blobs, px; NaN where a marker was not found.
        error_px: ``(n, m)`` distances to the reference, px; NaN likewise.
        step_us: ``(n,)`` time from map to blobs, us.
    """

    center_px: NDArray[np.float64]
    error_px: NDArray[np.float64]
    step_us: NDArray[np.float64]


class _Finder:
    """Blobs near the places where the markers should be."""

    def __init__(self, recording: CleanRecording) -> None:
        self._areas_px = blob_areas_px(recording.radius_px)
        self._near_px = PROXIMITY_SHARE * smallest_spacing_px(recording.reference_px)

    def find(self, state_map: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the blobs' centroids ``(k, 2)``, px."""
        return find_blobs(state_map, areas_px=self._areas_px).center_px

    def nearest(
        self, blobs_px: NDArray[np.float64], to_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return for each place its nearest blob ``(m, 2)``, or NaN where none is near."""
        if len(blobs_px) == 0:
            return np.full(to_px.shape, np.nan)
        offset = blobs_px[np.newaxis] - to_px[:, np.newaxis]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        nearest = blobs_px[distance.argmin(axis=1)]
        return np.where(distance.min(axis=1, keepdims=True) < self._near_px, nearest, np.nan)


def clean_centroids(
    recording: CleanRecording, kind: MapKind, every_us: int, first_us: int
) -> Centroids:
    """Return the centroids of the map without noise and drops.

    Args:
        recording: The clean recording.
        kind: Kind of the state map.
        every_us: Time between two moments, us.
        first_us: Time from the start to the first moment, us.
    """
    events = recording.events
    at_us = np.arange(events.t_start_us + first_us, events.t_end_us + 1, every_us)
    finder, center_px = _Finder(recording), recording.reference_px.astype(np.float64)
    rows, seen = [], []
    for state_map in state_maps(recording, events, kind, at_us):
        found = finder.nearest(finder.find(state_map), center_px)
        center_px = np.where(np.isnan(found), center_px, found)
        rows.append(center_px)
        seen.append(~np.isnan(found[:, 0]))
    centers = np.array(rows)
    moved = np.gradient(centers, at_us / 1e6, axis=0)
    return Centroids(at_us, centers, np.array(seen), np.hypot(moved[..., 0], moved[..., 1]))


def score_recording(
    recording: CleanRecording,
    kind: MapKind,
    degradation: Degradation,
    reference: Centroids,
    denoisers: Mapping[str, Denoiser],
) -> dict[str, Score]:
    """Score each denoiser, with and without the activity filter before the map.

    Args:
        recording: The clean recording.
        kind: Kind of the state map.
        degradation: The degradation of its events.
        reference: The reference positions.
        denoisers: Name -> denoiser.

    Returns:
        Method -> score; the names with the filter begin with ``activity+``.
    """
    noisy = degradation.apply(recording.events)
    plain = _score(recording, noisy, kind, reference, denoisers)
    behind = _score(recording, degradation.filtered(noisy), kind, reference, denoisers)
    return plain | {ACTIVITY + name: score for name, score in behind.items()}


def _score(
    recording: CleanRecording,
    events: EventPacket,
    kind: MapKind,
    reference: Centroids,
    denoisers: Mapping[str, Denoiser],
) -> dict[str, Score]:
    finder = _Finder(recording)
    centers: dict[str, list[NDArray[np.float64]]] = {name: [] for name in denoisers}
    times_us: dict[str, list[float]] = {name: [] for name in denoisers}
    maps = state_maps(recording, events, kind, reference.at_us)
    for state_map, true_px in zip(maps, reference.center_px, strict=True):
        for name, denoiser in denoisers.items():
            begin = perf_counter()
            blobs_px = finder.find(denoiser.clean(state_map))
            times_us[name].append(1e6 * (perf_counter() - begin))
            centers[name].append(finder.nearest(blobs_px, true_px))
    return {
        name: _scored(np.array(centers[name]), reference, np.array(times_us[name]))
        for name in denoisers
    }


def _scored(
    center_px: NDArray[np.float64], reference: Centroids, step_us: NDArray[np.float64]
) -> Score:
    offset = center_px - reference.center_px
    return Score(center_px, np.hypot(offset[..., 0], offset[..., 1]), step_us)


def state_maps(
    recording: CleanRecording, events: EventPacket, kind: MapKind, at_us: NDArray[np.int64]
) -> Iterator[NDArray[np.float32]]:
    """Yield the map at each moment, contiguous; the next one overwrites it."""
    shape = (events.size, recording.reference_px, recording.radius_px)
    state_map: StateMap = (
        BinaryStateMap(events.size, paint_binary_discs(*shape))
        if kind == "binary"
        else GradedStateMap(paint_discs(*shape))
    )
    first, start_us = 0, events.t_start_us
    for end_us, last in zip(at_us, np.searchsorted(events.t, at_us), strict=True):
        state_map.absorb(events.part(first, int(last), start_us, int(end_us)))
        first, start_us = int(last), int(end_us)
        yield np.ascontiguousarray(state_map.values, np.float32)
