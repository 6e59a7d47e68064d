"""The ``denoise`` experiment: the error of marker centroids behind each denoiser.

The methods are none, median3, box7, the shipped network in float32 and int8, and a network that was
trained with the simulator's noise-free maps (``supervised``, an upper bound); each with and without
the event-activity filter. The twin's recordings are rendered without noise and degraded afterwards,
so the reference is exact: the centroid in the same map without noise, event loss and activity
filter. Errors of the state map itself therefore do not count.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import Denoiser, NetworkDenoiser, make_denoiser
from spikingtac.events import BackgroundActivityFilter, open_events
from spikingtac.markers import PROXIMITY_SHARE, blob_areas_px, find_blobs, smallest_spacing_px
from spikingtac.sim import TRAJECTORIES, CameraChoice, SceneSource, load_scene
from spikingtac.state_map import (
    BinaryStateMap,
    GradedStateMap,
    StateMap,
    paint_binary_discs,
    paint_discs,
)
from spikingtac.types import US_PER_S, EventPacket, FloatArray
from spikingtac_paper.harness.report import (
    Metric,
    Report,
    Row,
    by_name,
    dot_figure,
    lines_of,
    write_report,
)
from spikingtac_paper.harness.run import Progress, RunOptions
from spikingtac_paper.training.dataset import maps_at, with_background, with_drops
from spikingtac_paper.trials.trajectories import GroundTruth
from spikingtac_paper.trials.trial import V2E

MapKind = Literal["binary", "graded"]
NAME = "denoise"
FIRST_SEED = 1001  # Is added to the run's seed, since training uses seeds 1 and 2.
FULL_SEEDS = 2  # Seeds of a full run.

# Prefix of the names of methods with the event-activity filter before the map.
ACTIVITY = "activity+"

# Cases on the first page: map, background (Hz/px) and fraction of dropped events.
FIRST = ("binary@1.0-0.5", "binary@0.05-0.1", "graded@1.0-0.5")
ABOUT = {
    "none": "the map as it is",
    "median3": "3x3 median",
    "box7": "7x7 mean",
    "network": "the shipped unsupervised network, float32",
    "network-int8": "the same in int8",
    "supervised": "SUPERVISED with the simulator's noise-free maps: an upper bound, not a method",
    f"{ACTIVITY}...": "the same behind the event-activity filter",
}

# Network that was trained with noise-free maps: an upper bound. Only the source tree has it.
SUPERVISED = Path(__file__).resolve().parents[2] / "results" / "denoise" / "supervised.onnx"

# Methods of the report. An installed package has no ``supervised``.
METHODS = (
    *("none", "median3", "box7", "network", "network-int8"),
    *(("supervised",) if SUPERVISED.is_file() else ()),
)

# Test recording with a kind of motion that is not in the training recordings.
HELD_OUT = "finger-torsion"

# Background rate times window of the activity filter; about an eighth of the fraction of
# noise events that pass. The filter is the same for all methods.
FILTER_PRODUCT = 0.03
LONGEST_FILTER_US = 80_000  # Longest window of the activity filter, us.
FAST_PX_S = 20.0  # Markers that move faster count as fast, others as slow, px/s.
METRICS = by_name(
    Metric("centroid_mean_px", "px", "distance of a found blob's centroid to the marker's true "
           "centre, mean"),
    Metric("excess_mean_px", "px", "distance of a found blob's centroid to that which the same map "
           "gives without noise, drops and activity filter, mean over markers and moments"),
    Metric("recall", "1", "fraction of the markers and moments of the clean map that have a blob "
           "within half a pitch of the clean centroid"),
    Metric("step_p50_us", "us", "time from map to blobs, median over the moments"),
)  # fmt: skip

# The typical camera without its noise.
QUIET = CameraChoice(
    preset="typical",
    settings={
        "background": {"rate_hz": 0.0, "hot_fraction": 0.0},
        "pixel": {"leak_hz": 0.0},
    },
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """What is scored on each recording (ranges assumed, beyond those of the sensor's presets).

    Attributes:
        duration_s: Length of each recording, s.
        noise_hz: Background rates, per pixel and second.
        drop: Fractions of the signal events that are dropped.
        every_us: Time between two scored moments, us.
        first_us: Time from the start of a recording to its first moment, us.
    """

    duration_s: float = 6.0
    noise_hz: tuple[float, ...] = (0.05, 0.2, 1.0, 5.0)
    drop: tuple[float, ...] = (0.0, 0.1, 0.3, 0.5)
    every_us: int = 100_000
    first_us: int = 500_000


# A quick run has fewer moments, but nearly full length: noise accumulates in a binary map.
QUICK_PLAN = Plan(duration_s=5.0, every_us=500_000)


class Job(NamedTuple):
    """One recording for one process: a scene, or the v2e recording of a folder."""

    plan: Plan
    scene: str
    seed: int
    data: Path | None = None


class Sample(NamedTuple):
    """The scores of one method on one recording.

    Attributes:
        excess_px: Distances to the clean centroid, NaN where the marker was not found.
        centroid_px: Distances to the true centre, NaN where the marker was not found.
        step_us: Computing times of the steps, us.
        source: ``twin`` or ``v2e``.
    """

    excess_px: FloatArray
    centroid_px: FloatArray
    step_us: FloatArray
    source: str


Samples = dict[tuple[str, str], list[Sample]]  # (case, method) -> samples of all recordings.


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    count = options.seeds or (1 if options.quick else FULL_SEEDS)
    seeds = tuple(FIRST_SEED + options.seed + number for number in range(count))
    plan = QUICK_PLAN if options.quick else Plan()
    settings = options.begin(experiment=NAME, seeds=seeds, **asdict(plan))
    jobs = [Job(plan, scene, seed) for scene in TRAJECTORIES for seed in seeds]
    if options.data is not None and (options.data / V2E / "mix.raw").is_file():
        jobs.insert(0, Job(plan, "mix", seeds[0], options.data))
    with options.pool(len(jobs)) as pool:
        rows = report_rows(Progress(options, len(jobs)).run(pool, score_job, jobs))
    cases = {row.case: row.case for row in rows if "/" not in row.case}
    drawn = [ACTIVITY + name for name in METHODS]
    caption = "excess_mean_px of every map, noise and loss, behind the activity filter (simulated)"
    report = Report(
        title="Denoising",
        settings=settings,
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, drawn),
        figures=[(caption, dot_figure(rows, cases, drawn, "excess_mean_px"))],
        methods=ABOUT,
    )
    return write_report(report, options)


def score_job(job: Job) -> Samples:
    """Make one recording and score every method in every case on it."""
    if job.data is not None:
        return score_all(open_v2e(job.data / V2E), job.plan, job.seed)
    return score_all(render(job.scene, job.seed, job.plan.duration_s), job.plan, job.seed)


@dataclass(frozen=True, slots=True)
class CleanRecording:
    """A recording with as little noise as possible.

    Attributes:
        name: Name of the scene or file.
        events: All its events.
        truth: Where its markers are; the first map is painted from their rests.
        source: ``twin`` or ``v2e``.
    """

    name: str
    events: EventPacket
    truth: GroundTruth
    source: str


def render(scene_name: str, seed: int, duration_s: float) -> CleanRecording:
    """Render one recording of the twin without noise, with its truth."""
    source = SceneSource(replace(load_scene(scene_name), camera=QUIET), seed, duration_s)
    steps = list(source.steps())
    t_us, marker_px = (
        np.concatenate([getattr(step.truth, name) for step in steps])
        for name in ("marker_t_us", "marker_px")
    )
    known = GroundTruth(
        t_us, marker_px.astype(np.float64), source.reference_px, source.radius_px, 0
    )
    events = EventPacket.concatenate([step.packet for step in steps])
    return CleanRecording(scene_name, events, known, "twin")


def open_v2e(folder: Path) -> CleanRecording:
    """Open the v2e recording ``mix``; its own noise (0.1 Hz/px) remains in it."""
    source = open_events(folder / "mix.raw")
    events = EventPacket.concatenate([packet for packet in source if len(packet)])
    return CleanRecording("mix", events, GroundTruth.load(folder / "mix.truth.npz"), "v2e")


class Centroids(NamedTuple):
    """The reference positions.

    Attributes:
        at_us: ``(n,)`` moments, us.
        center_px: ``(n, m, 2)`` centroids in the clean map, px. Where it does not show a marker as
            one blob (two markers touch, or one lies at the border), the last centroid.
        found: ``(n, m)`` False there; such moments are not scored.
        speed_px_s: ``(n, m)`` speed of each centroid, px/s.
    """

    at_us: NDArray[np.int64]
    center_px: FloatArray
    found: NDArray[np.bool_]
    speed_px_s: FloatArray


def window_us(noise_hz: float) -> int:
    """Return the window of the activity filter for a background rate, us.

    A shorter window passes less noise, but it also removes events of slow motions, which have
    no neighbour within the window. The rate is measured on an untouched sensor.
    """
    return round(min(US_PER_S * FILTER_PRODUCT / noise_hz, LONGEST_FILTER_US))


def score_all(recording: CleanRecording, plan: Plan, seed: int) -> Samples:
    """Score every method in every case on one recording."""
    denoisers = {
        name: NetworkDenoiser(SUPERVISED) if name == "supervised" else make_denoiser(name)
        for name in METHODS
    }
    samples: Samples = defaultdict(list)
    events, source = recording.events, recording.source
    for kind in get_args(MapKind):
        reference = clean_centroids(recording, kind, plan)
        true_px, fast = recording.truth.at(reference.at_us), reference.speed_px_s > FAST_PX_S
        every = np.ones_like(fast)
        groups = {"": every, "fast/": fast, "slow/": ~fast} if source == "twin" else {}
        groups |= {"heldout/": every} if recording.name == HELD_OUT else {}
        groups |= {f"{source}/": every} if source != "twin" else {}
        for denoiser in denoisers.values():  # fills the caches
            denoiser.clean(np.zeros(events.size[::-1], np.float32))
        for noise_hz, drop in product(plan.noise_hz, plan.drop):
            random = np.random.default_rng(seed)
            noisy = with_background(with_drops(events, drop, random), noise_hz, random)
            filtered = BackgroundActivityFilter(events.size, window_us(noise_hz))(noisy)
            for before, degraded in (("", noisy), (ACTIVITY, filtered)):
                told = measured(recording, degraded, kind, reference, denoisers)
                for name, (center_px, step_us) in told.items():
                    excess_px = distance_px(center_px, reference.center_px)
                    centroid_px = distance_px(center_px, true_px)
                    for prefix, chosen in groups.items():
                        scored = chosen & reference.found
                        key = f"{prefix}{kind}@{float(noise_hz)}-{float(drop)}", before + name
                        sample = Sample(excess_px[scored], centroid_px[scored], step_us, source)
                        samples[key].append(sample)
    return samples


def distance_px(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the distances ``(n, m)`` of places ``(n, m, 2)``, px."""
    offset = one - other
    return np.hypot(offset[..., 0], offset[..., 1])


class _Finder:
    """Blobs near the places where the markers should be."""

    def __init__(self, recording: CleanRecording) -> None:
        self._areas_px = blob_areas_px(recording.truth.radius_px)
        self._near_px = PROXIMITY_SHARE * smallest_spacing_px(recording.truth.reference_px)

    def find(self, state_map: NDArray[np.float32]) -> FloatArray:
        """Return the blobs' centroids ``(k, 2)``, px."""
        return find_blobs(state_map, areas_px=self._areas_px).center_px

    def nearest(self, blobs_px: FloatArray, to_px: FloatArray) -> FloatArray:
        """Return for each place its nearest blob ``(m, 2)``, or NaN where none is near."""
        if len(blobs_px) == 0:
            return np.full(to_px.shape, np.nan)
        away = distance_px(blobs_px[np.newaxis], to_px[:, np.newaxis])
        nearest = blobs_px[away.argmin(axis=1)]
        return np.where(away.min(axis=1, keepdims=True) < self._near_px, nearest, np.nan)


def clean_centroids(recording: CleanRecording, kind: MapKind, plan: Plan) -> Centroids:
    """Return the centroids of the map without noise and drops."""
    events = recording.events
    at_us = np.arange(events.t_start_us + plan.first_us, events.t_end_us + 1, plan.every_us)
    finder, center_px = _Finder(recording), recording.truth.reference_px.astype(np.float64)
    rows, seen = [], []
    for state_map in _state_maps(recording, events, kind, at_us):
        found = finder.nearest(finder.find(state_map), center_px)
        center_px = np.where(np.isnan(found), center_px, found)
        rows.append(center_px)
        seen.append(~np.isnan(found[:, 0]))
    centers = np.array(rows)
    moved = np.gradient(centers, at_us / 1e6, axis=0)
    return Centroids(at_us, centers, np.array(seen), np.hypot(moved[..., 0], moved[..., 1]))


def measured(
    recording: CleanRecording,
    events: EventPacket,
    kind: MapKind,
    reference: Centroids,
    denoisers: Mapping[str, Denoiser],
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Measure the markers in the map of some events behind each denoiser.

    Args:
        recording: The clean recording.
        events: Its events, degraded.
        kind: Kind of the state map.
        reference: The reference positions.
        denoisers: Name -> denoiser.

    Returns:
        Name -> centroids of the blobs ``(n, m, 2)``, px, NaN where a marker was not found, and
        time from map to blobs ``(n,)``, us.
    """
    finder = _Finder(recording)
    centers: dict[str, list[FloatArray]] = {name: [] for name in denoisers}
    times_us: dict[str, list[float]] = {name: [] for name in denoisers}
    maps = _state_maps(recording, events, kind, reference.at_us)
    for state_map, clean_px in zip(maps, reference.center_px, strict=True):
        for name, denoiser in denoisers.items():
            begin = perf_counter()
            blobs_px = finder.find(denoiser.clean(state_map))
            times_us[name].append(1e6 * (perf_counter() - begin))
            centers[name].append(finder.nearest(blobs_px, clean_px))
    return {name: (np.array(centers[name]), np.array(times_us[name])) for name in denoisers}


def _state_maps(
    recording: CleanRecording, events: EventPacket, kind: MapKind, at_us: NDArray[np.int64]
) -> Iterator[NDArray[np.float32]]:
    """Yield the map at each moment, contiguous; the next one overwrites it."""
    shape = (events.size, recording.truth.reference_px, recording.truth.radius_px)
    state_map: StateMap = (
        BinaryStateMap(events.size, paint_binary_discs(*shape))
        if kind == "binary"
        else GradedStateMap(paint_discs(*shape))
    )
    for levels in maps_at(state_map, events, at_us):
        yield np.ascontiguousarray(levels, np.float32)


def report_rows(parts: Sequence[Samples]) -> list[Row]:
    """Return the rows of the report from the samples of all recordings."""
    merged: Samples = defaultdict(list)
    for part in parts:
        for key, samples in part.items():
            merged[key] += samples
    rows = []
    for (case, method), samples in merged.items():
        *columns, sources = zip(*samples, strict=True)
        excess_px, centroid_px, step_us = (np.concatenate(column) for column in columns)
        found = ~np.isnan(excess_px)
        count = int(found.sum())
        values = {
            "centroid_mean_px": (float(centroid_px[found].mean()) if count else None, count),
            "excess_mean_px": (float(excess_px[found].mean()) if count else None, count),
            "recall": (float(found.mean()) if len(found) else None, len(found)),
            "step_p50_us": (float(np.median(step_us)), len(step_us)),
        }
        if len(found):
            rows += [
                METRICS[metric].row(method, case, value, n, source=sources[0])
                for metric, (value, n) in values.items()
            ]
    return rows
