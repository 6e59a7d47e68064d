"""How costs grow with markers and events: 64, 256, 1,024 markers; 2, 10, 50 Mev/s; calibration."""

from __future__ import annotations

import gc
import os
import tempfile
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.batch.run_folder import begin_run
from spikingtac.events.create import create_events
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.report import Report, Table
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.throughput.bench_stream import BenchStream
from spikingtac_paper.throughput.skin_stream import (
    SKINS,
    Skin,
    calibration_at_rest,
    skin_stream,
    slides,
)
from spikingtac_paper.throughput.stopwatch import (
    PACE_US,
    US_PER_S,
    free_run,
    in_own_process,
    largest_memory_mb,
    windows_of,
)
from spikingtac_paper.trials.methods import main_methods

NAME = "skins"
METHODS = ("default", "fast")
RATES_MEV_S = (2, 10, 50)
DURATION_US, QUICK_DURATION_US = 400_000, 120_000
DEFINITIONS = {
    "step_p50_us": "median of absorb + estimate, every ms, free running",
    "step_p99_us": "99th percentile of the same",
    "absorb_mev_s": "events per window over the median time to absorb them",
    "start_s": "time to make the tracker",
    "error_mean_px": "mean distance of detected_px to the truth over the stream",
    "events_mev_s": "events of the stream per second",
}
CALIBRATION = "calibrate"
"""What the calibration is called where trackers are named."""

CALIBRATION_DEFINITIONS = {
    "calibration_s": "time to calibrate from slides in six directions, 6.4 s long, in a process "
    "whose kernels are compiled",
    "peak_mb": "largest memory of that process",
    "rest_error_px": "mean distance of the rests to the truth",
    "events_mev": "events of the slides",
}
UNITS = {
    "calibration_s": "s",
    "peak_mb": "MB",
    "rest_error_px": "px",
    "events_mev": "Mev",
    "absorb_mev_s": "Mev/s",
    "start_s": "s",
    "error_mean_px": "px",
    "events_mev_s": "Mev/s",
}


def run(options: RunOptions) -> dict[str, Any]:
    """Run the bench, write its report, and return a summary."""
    settings = {"bench": NAME, "quick": options.quick, "seed": options.seed}
    begin_run(options.output, settings, options.resume, options.overwrite)
    rows: list[Row] = []
    cases: list[tuple[Skin, int | None]] = list(product(SKINS, (*RATES_MEV_S, None)))
    for number, (skin, rate) in enumerate(cases, 1):
        rows += _calibration(skin, options) if rate is None else _case(skin, rate, options)
        if options.advance:
            options.advance(number / len(cases))
    command = f"spikingtac bench {NAME} -o {options.output.name}"
    report = Report(
        experiment=NAME,
        title="Big skins",
        provenance=provenance(command + (" --quick" if options.quick else ""), settings)
        | {"cores": _cores()},
        rows=rows,
        findings=[_finding(rows, method, skin) for method in METHODS for skin in SKINS]
        + [_calibration_finding(rows, skin) for skin in SKINS],
        tables=[
            Table.of_case(case_of(skin, None), CALIBRATION_DEFINITIONS, [CALIBRATION])
            if rate is None
            else Table.of_case(case_of(skin, rate), DEFINITIONS, METHODS)
            for skin, rate in cases
        ],
    )
    return write_report(report, options.output)


def case_of(skin: Skin, rate_mev_s: int | None) -> str:
    """Return the name of a case: markers and events, ``1024@10``, or slides, ``1024 slides``."""
    return f"{skin.count} slides" if rate_mev_s is None else f"{skin.count}@{rate_mev_s}"


def _case(skin: Skin, rate_mev_s: int, options: RunOptions) -> Iterator[Row]:
    duration_us = QUICK_DURATION_US if options.quick else DURATION_US
    stream = skin_stream(skin, rate_mev_s, options.seed, duration_us)
    for method in METHODS:
        for metric, value in _measured(method, skin, stream).items():
            yield Row(
                method=method,
                case=case_of(skin, rate_mev_s),
                metric=metric,
                value=value,
                unit=UNITS.get(metric, "us"),
                n=duration_us // PACE_US,
                source="twin",
                paper=None,
                definition=DEFINITIONS[metric],
            )


def _calibration(skin: Skin, options: RunOptions) -> Iterator[Row]:
    stream = slides(skin, options.seed)
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder, "slides.raw")
        with create_events(recording, skin.size) as writer:
            writer.write(stream.events)
        reference_px = stream.truth.reference_px
        in_own_process(calibrate_recording, recording, reference_px)  # compiles
        found = in_own_process(calibrate_recording, recording, reference_px)
    values = dict(zip(CALIBRATION_DEFINITIONS, (*found, len(stream.events) / 1e6), strict=True))
    for metric, value in values.items():
        yield Row(
            method=CALIBRATION,
            case=case_of(skin, None),
            metric=metric,
            value=float(value),
            unit=UNITS[metric],
            n=skin.count,
            source="twin",
            paper=None,
            definition=CALIBRATION_DEFINITIONS[metric],
        )


def calibrate_recording(queue: Any, recording: Path, reference_px: NDArray[np.float64]) -> None:
    """Calibrate from a file; put seconds, largest memory in MB and the error of the rests, px.

    Args:
        queue: Is given the figures.
        recording: Slides.
        reference_px: ``(m, 2)`` the true places at rest.
    """
    begun_s = time.perf_counter()
    found = calibrate(open_events(recording))
    seconds = time.perf_counter() - begun_s
    error_px = np.nan
    if found.reference_px.shape == reference_px.shape:
        error_px = float(np.linalg.norm(found.reference_px - reference_px, axis=1).mean())
    queue.put(np.array([seconds, largest_memory_mb(), error_px]))


def _measured(method: str, skin: Skin, stream: BenchStream) -> dict[str, float]:
    windows, calibration = windows_of(stream, PACE_US), calibration_at_rest(skin, stream)
    build = main_methods()[method].build
    free_run(build(calibration), windows[:20], stream)  # compiles, and fills the caches
    begun_s = time.perf_counter()
    tracker = build(calibration)
    start_s = time.perf_counter() - begun_s
    gc.collect()
    gc.disable()
    try:
        found = free_run(tracker, windows, stream)
    finally:
        gc.enable()
    absorb_us = float(np.median(found.step_us - found.estimate_us))
    return {
        "step_p50_us": float(np.median(found.step_us)),
        "step_p99_us": float(np.percentile(found.step_us, 99)),
        "absorb_mev_s": stream.rate_hz / US_PER_S * PACE_US / absorb_us,
        "start_s": start_s,
        "error_mean_px": found.error_px,
        "events_mev_s": stream.rate_hz / US_PER_S,
    }


def _finding(rows: list[Row], method: str, skin: Skin) -> str:
    parts = []
    for rate in RATES_MEV_S:
        case = case_of(skin, rate)
        values = {row.metric: row.value for row in rows if (row.method, row.case) == (method, case)}
        parts.append(
            f"{values['step_p50_us']:.0f} us at {rate} Mev/s (p99 {values['step_p99_us']:.0f}, "
            f"absorbed at {values['absorb_mev_s']:.0f} Mev/s, {values['error_mean_px']:.3f} px)"
        )
    return f"{method}, {skin.count} markers: " + "; ".join(parts) + "."


def _calibration_finding(rows: list[Row], skin: Skin) -> str:
    values = {row.metric: row.value for row in rows if row.case == case_of(skin, None)}
    return (
        f"calibration of {skin.count} markers from {values['events_mev']:.0f} million events: "
        f"{values['calibration_s']:.0f} s, {values['peak_mb']:.0f} MB, rests within "
        f"{values['rest_error_px']:.3f} px."
    )


def _cores() -> int:
    available = getattr(os, "sched_getaffinity", None)
    return len(available(0)) if available else os.cpu_count() or 1
