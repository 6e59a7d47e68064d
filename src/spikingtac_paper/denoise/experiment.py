"""The ``denoise`` experiment: the error of marker centroids behind each denoiser.

The methods are none, median3, box7, the shipped network in float32 and int8, and a network that was
trained with the simulator's noise-free maps (``supervised``, an upper bound); each with and without
the event-activity filter. The twin's recordings are rendered without noise and degraded afterwards,
so the reference is exact.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from spikingtac.denoise import Denoiser, NetworkDenoiser, make_denoiser
from spikingtac.schema import to_mapping
from spikingtac.sim import TRAJECTORIES
from spikingtac_paper.denoise.scoring import (
    ACTIVITY,
    Centroids,
    CleanRecording,
    Degradation,
    MapKind,
    Score,
    clean_centroids,
    open_v2e,
    render,
    score_recording,
)
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
from spikingtac_paper.training.dataset import US_PER_S
from spikingtac_paper.trials.trial import V2E

NAME = "denoise"
FIRST_SEED = 1001  # Is added to the run's seed, since training uses seeds 1 and 2.
FULL_SEEDS = 2  # Seeds of a full run.

# Settings of a quick run: fewer moments, but nearly full length, since noise accumulates in a
# binary map.
QUICK = {"duration_s": 5.0, "every_us": 500_000}

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
SUPERVISED = Path(__file__).resolve().parents[3] / "results" / "denoise" / "supervised.onnx"

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


@dataclass(frozen=True, kw_only=True, slots=True)
class DenoiseConfig:
    """The settings of the experiment; all values are ours.

    Attributes:
        scenes: Scenes of the twin.
        seeds: Seeds of each scene; training uses others.
        duration_s: Length of each recording, s.
        noise_hz: Background rates, per pixel and second.
        drop: Fractions of the signal events that are dropped.
        maps: Kinds of state map.
        longest_us: Longest window of the activity filter, us.
        every_us: Time between two scored moments, us.
        first_us: Time from the start of a recording to its first moment, us.
    """

    scenes: tuple[str, ...] = TRAJECTORIES
    seeds: tuple[int, ...] = (1001,)
    duration_s: float = 6.0
    noise_hz: tuple[float, ...] = (0.05, 0.2, 1.0, 5.0)
    drop: tuple[float, ...] = (0.0, 0.1, 0.3, 0.5)
    maps: tuple[MapKind, ...] = field(default_factory=lambda: get_args(MapKind))
    longest_us: int = 80_000
    every_us: int = 100_000
    first_us: int = 500_000

    def window_us(self, noise_hz: float) -> int:
        """Return the window of the activity filter for a background rate, us.

        A shorter window passes less noise, but it also removes events of slow motions, which have
        no neighbour within the window. The rate is measured on an untouched sensor.
        """
        return round(min(US_PER_S * FILTER_PRODUCT / noise_hz, self.longest_us))


Samples = dict[tuple[str, str], list["Sample"]]  # (case, method) -> samples of all recordings.


@dataclass(frozen=True, slots=True)
class Sample:
    """The scores of one method on one recording.

    Attributes:
        excess_px: Distances to the clean centroid, NaN where the marker was not found.
        centroid_px: Distances to the true centre, NaN where the marker was not found.
        step_us: Computing times of the steps, us.
        source: ``twin`` or ``v2e``.
    """

    excess_px: NDArray[np.float64]
    centroid_px: NDArray[np.float64]
    step_us: NDArray[np.float64]
    source: str


@dataclass(frozen=True, slots=True)
class RecordingJob:
    """One recording for one process: a scene, or the v2e recording of a folder."""

    config: DenoiseConfig
    scene: str
    seed: int
    data: Path | None = None


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary."""
    count = options.seeds or (1 if options.quick else FULL_SEEDS)
    seeds = tuple(FIRST_SEED + options.seed + number for number in range(count))
    config = replace(DenoiseConfig(seeds=seeds), **(QUICK if options.quick else {}))
    settings = {"experiment": NAME, "quick": options.quick, **to_mapping(config)}
    options.begin(settings)
    jobs = [RecordingJob(config, scene, seed) for scene in config.scenes for seed in config.seeds]
    if options.data is not None and (options.data / V2E / "mix.raw").is_file():
        jobs.insert(0, RecordingJob(config, "mix", config.seeds[0], options.data))
    with options.pool(len(jobs)) as pool:
        parts = Progress(options, len(jobs)).run(pool, score_job, jobs)
    rows = report_rows(parts)
    cases = {row.case: row.case for row in rows if "/" not in row.case}
    drawn = [ACTIVITY + name for name in METHODS]
    report = Report(
        title="Denoising",
        settings=settings,
        rows=rows,
        first=FIRST,
        findings=lines_of(rows, FIRST, drawn),
        figures=[
            (
                "excess_mean_px of every map, noise and loss, behind the activity filter "
                "(simulated)",
                dot_figure(rows, cases, drawn, "excess_mean_px"),
            )
        ],
        methods=ABOUT,
    )
    return write_report(report, options)


def score_job(job: RecordingJob) -> Samples:
    """Make one recording and score every method in every case on it."""
    if job.data is not None:
        return score_all(open_v2e(job.data / V2E), job.config, job.seed)
    return score_all(render(job.scene, job.seed, job.config.duration_s), job.config, job.seed)


def denoiser_of(method: str) -> Denoiser:
    """Return the denoiser behind a method of the report."""
    return NetworkDenoiser(SUPERVISED) if method == "supervised" else make_denoiser(method)


def score_all(recording: CleanRecording, config: DenoiseConfig, seed: int) -> Samples:
    """Score every method in every case on one recording."""
    denoisers = {name: denoiser_of(name) for name in METHODS}
    samples: Samples = defaultdict(list)
    for kind in config.maps:
        reference = clean_centroids(recording, kind, config.every_us, config.first_us)
        _warm_up(denoisers, recording)
        for noise_hz in config.noise_hz:
            for drop in config.drop:
                case = f"{kind}@{float(noise_hz)}-{float(drop)}"
                degradation = Degradation(
                    noise_hz=noise_hz, drop=drop, window_us=config.window_us(noise_hz), seed=seed
                )
                scores = score_recording(recording, kind, degradation, reference, denoisers)
                for method, score in scores.items():
                    for prefix, sample in _samples(recording, reference, score, config):
                        samples[prefix + case, method].append(sample)
    return samples


def report_rows(parts: Sequence[Samples]) -> list[Row]:
    """Return the rows of the report from the samples of all recordings."""
    merged: Samples = defaultdict(list)
    for part in parts:
        for key, samples in part.items():
            merged[key] += samples
    return [
        METRICS[metric].row(method, case, value, count, source=samples[0].source)
        for (case, method), samples in merged.items()
        if sum(sample.excess_px.size for sample in samples)
        for metric, (value, count) in _metrics(samples).items()
    ]


def _warm_up(denoisers: Mapping[str, Denoiser], recording: CleanRecording) -> None:
    width, height = recording.events.size
    for denoiser in denoisers.values():
        denoiser.clean(np.zeros((height, width), np.float32))


def _samples(
    recording: CleanRecording, reference: Centroids, score: Score, config: DenoiseConfig
) -> list[tuple[str, Sample]]:
    """Return (prefix of the case, sample) for every case to which a score contributes."""
    source = recording.source
    centroid_px = np.hypot(
        *np.moveaxis(score.center_px - recording.true_px(reference.at_us), -1, 0)
    )

    def sample_of(where: NDArray[np.bool_]) -> Sample:
        scored = where & reference.found
        return Sample(score.error_px[scored], centroid_px[scored], score.step_us, source)

    every = np.ones_like(reference.found)
    if source != "twin":
        return [(f"{source}/", sample_of(every))]
    fast = reference.speed_px_s > FAST_PX_S
    out = [("", sample_of(every)), ("fast/", sample_of(fast)), ("slow/", sample_of(~fast))]
    if recording.name == HELD_OUT:
        out.append(("heldout/", sample_of(every)))
    return out


def _metrics(samples: Sequence[Sample]) -> dict[str, tuple[float | None, int]]:
    excess_px = np.concatenate([sample.excess_px for sample in samples])
    centroid_px = np.concatenate([sample.centroid_px for sample in samples])
    step_us = np.concatenate([sample.step_us for sample in samples])
    found = ~np.isnan(excess_px)
    count = int(found.sum())
    return {
        "centroid_mean_px": (float(centroid_px[found].mean()) if count else None, count),
        "excess_mean_px": (float(excess_px[found].mean()) if count else None, count),
        "recall": (float(found.mean()), len(found)),
        "step_p50_us": (float(np.median(step_us)), len(step_us)),
    }
