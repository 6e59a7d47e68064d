"""Rates and latencies: 2 Mev/s, 64 markers, one core, beside tuned peers on the same stream."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from spikingtac import Calibration
from spikingtac.config import digest
from spikingtac_paper.harness.report import Metric, Report, Row, by_name, lines_of, write_report
from spikingtac_paper.harness.run import Record, RunOptions, code_digest, kept
from spikingtac_paper.throughput.decoding import decoder_rows
from spikingtac_paper.throughput.peers import PEERS
from spikingtac_paper.throughput.stopwatch import (
    PACE_US,
    FreeRun,
    free_run,
    in_own_process,
    paced_run,
    windows_of,
)
from spikingtac_paper.throughput.stream import BenchStream, bench_stream
from spikingtac_paper.trials.methods import main_methods
from spikingtac_paper.trials.trial import Trial, calibration_of

NAME = "throughput"
CAMERAS = ("typical", "noisy")
OWN = ("default", "fast", "paper")
PACED = ("default", "fast")
FAST_US = 100  # Period of ``fast``: 10 kHz.

TURNS, QUICK_TURNS = 20, 6  # Full circles of the skin's motion in the stream: about 3.5 s, 1 s.

PACED_S, QUICK_PACED_S = 30.0, 5.0

# Slow peers estimate at every n-th window only, to bound the duration; times are per estimate.
SLOW_EVERY = {"trackpy": 10}

METRICS = by_name(
    Metric("step_p50_us", "us", "median of absorb + estimate, free running, one core"),
    Metric("step_p99_us", "us", "99th percentile of the same"),
    Metric("error_mean_px", "px", "mean distance of detected_px to the truth over the stream"),
    Metric("speedup_vs_opencv_tuned", "times", "median map-to-centres time of tuned OpenCV over "
           "this one's, same 1 ms stream, same run"),
    Metric("paced_1khz_p99_us", "us", "99th percentile from a window's end to its output, paced, "
           "own process"),
    Metric("paced_1khz_missed", "1", "share of steps that were not done when the next window was "
           "complete"),
)  # fmt: skip


def run(options: RunOptions) -> dict[str, Any]:
    """Run the bench, write its report, and return a summary."""
    settings = {"bench": NAME, "quick": options.quick, "seed": options.seed}
    options.begin(settings)
    parts: list[Record] = []
    for camera in CAMERAS:
        key = digest({"camera": camera, "settings": settings, "code": code_digest()})
        path = options.output / "parts" / f"{camera}.json"
        parts.append(kept(path, key, lambda camera=camera: _part(camera, options)))
        options.report_progress(len(parts), len(CAMERAS))
    rows = [Row(**row) for part in parts for row in part["rows"]]
    rates = {camera: part["rate_hz"] for camera, part in zip(CAMERAS, parts, strict=True)}
    report = Report(
        title="Throughput",
        settings=settings,
        about={"stream_events_per_s": rates},
        rows=rows,
        findings=lines_of(rows, CAMERAS, OWN),
    )
    return write_report(report, options)


def _part(camera: str, options: RunOptions) -> Record:
    """Measure on one camera's stream."""
    stream = bench_stream(camera, options.seed, QUICK_TURNS if options.quick else TURNS)
    sensor = Trial(case=camera, scene="quiet", seed=options.seed, camera=camera)
    calibration = calibration_of(sensor, options.output)
    rows = list(_camera_rows(camera, stream, calibration, options.quick))
    if camera == CAMERAS[0]:
        rows += decoder_rows(stream.events, options.output)
    return {"rate_hz": stream.rate_hz, "rows": [asdict(row) for row in rows]}


def paced_process(
    queue: Any, name: str, stream: BenchStream, calibration: Calibration, duration_s: float
) -> None:
    """Do the paced run of one method; the body of its own process.

    Args:
        queue: Takes the latencies, us.
        name: Method.
        stream: The stream.
        calibration: Of the sensor.
        duration_s: How long, s.
    """
    gc.disable()
    windows = windows_of(stream, PACE_US)
    queue.put(paced_run(main_methods()[name].build, calibration, windows, duration_s))


def _camera_rows(
    camera: str, stream: BenchStream, calibration: Calibration, quick: bool
) -> Iterator[Row]:
    methods, windows = main_methods(), windows_of(stream, PACE_US)
    at_1khz: dict[str, FreeRun] = {
        name: free_run(methods[name].build(calibration), windows, stream) for name in OWN
    }
    for name, build in PEERS.items():
        at_1khz[name] = free_run(build(calibration), windows, stream, SLOW_EVERY.get(name, 1))
    peer_us = float(np.median(at_1khz["opencv_tuned"].estimate_us))
    for name, at_pace in at_1khz.items():
        own = at_pace
        if name == "fast":
            fine = windows_of(stream, FAST_US)
            own = free_run(methods[name].build(calibration), fine, stream)
        values = {
            "step_p50_us": float(np.median(own.step_us)),
            "step_p99_us": float(np.percentile(own.step_us, 99)),
            "error_mean_px": own.error_px,
            "speedup_vs_opencv_tuned": peer_us / float(np.median(at_pace.estimate_us)),
        }
        if name in PACED:
            duration_s = QUICK_PACED_S if quick else PACED_S
            late_us = in_own_process(paced_process, name, stream, calibration, duration_s)
            values["paced_1khz_p99_us"] = float(np.percentile(late_us, 99))
            values["paced_1khz_missed"] = float((late_us > PACE_US).mean())
        for metric, value in values.items():
            yield METRICS[metric].row(name, camera, value, len(own.step_us))
