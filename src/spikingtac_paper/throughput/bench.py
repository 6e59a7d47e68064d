"""Rates and latencies: 2 Mev/s, 64 markers, one core, beside tuned peers on the same stream."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.atomic_files import write_json
from spikingtac.batch.run_folder import begin_run
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import digest
from spikingtac_paper.harness.fingerprint import code_digest, provenance
from spikingtac_paper.harness.report import Report, Table, find_row
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.throughput.bench_stream import BenchStream, kept_stream
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
from spikingtac_paper.trials.calibrations import calibration_of
from spikingtac_paper.trials.methods import main_methods

NAME = "throughput"
CAMERAS = ("typical", "noisy")
OWN = ("default", "fast", "paper")
PACED = ("default", "fast")
FAST_US = 100
"""Period of ``fast``: 10 kHz."""

TURNS, QUICK_TURNS = 20, 6
"""Full circles of the skin's motion in the stream: about 3.5 s, 1 s."""

PACED_S, QUICK_PACED_S = 30.0, 5.0
SLOW_EVERY = {"trackpy": 10}
"""Slow peers estimate at every n-th window only, to bound the duration; times are per estimate."""

DEFINITIONS = {
    "step_p50_us": "median of absorb + estimate, free running, one core",
    "step_p99_us": "99th percentile of the same",
    "error_mean_px": "mean distance of detected_px to the truth over the stream",
    "speedup_vs_opencv_tuned": "median map-to-centres time of tuned OpenCV over this one's, "
    "same 1 ms stream, same run",
    "paced_1khz_p99_us": "99th percentile from a window's end to its output, paced, own process",
    "paced_1khz_missed": "share of steps that were not done when the next window was complete",
}
UNITS = {"error_mean_px": "px", "speedup_vs_opencv_tuned": "times", "paced_1khz_missed": "1"}


def run(options: RunOptions) -> dict[str, Any]:
    """Run the bench, write its report, and return a summary."""
    settings = {"bench": NAME, "quick": options.quick, "seed": options.seed}
    begin_run(options.output, settings, options.resume, options.overwrite)
    rows: list[Row] = []
    rates = {}
    for number, camera in enumerate(CAMERAS, 1):
        part = _part(camera, options, settings)
        rates[camera] = part["rate_hz"]
        rows += [Row(**row) for row in part["rows"]]
        if options.advance:
            options.advance(number / len(CAMERAS))
    command = f"spikingtac bench {NAME} -o {options.output.name}"
    report = Report(
        experiment=NAME,
        title="Throughput",
        provenance=provenance(command + (" --quick" if options.quick else ""), settings)
        | {"stream_events_per_s": rates},
        rows=rows,
        findings=_findings(rows),
        tables=_tables(rows),
    )
    return write_report(report, options.output)


def _part(camera: str, options: RunOptions, settings: dict[str, Any]) -> dict[str, Any]:
    """Return one camera's rows; those of an interrupted run where the code is the same."""
    key = digest({"camera": camera, "settings": settings, "code": code_digest()})
    path = options.output / "parts" / f"{camera}-{key}.json"
    if options.resume and path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    turns = QUICK_TURNS if options.quick else TURNS
    stream = kept_stream(camera, options.seed, turns, options.output)
    calibration = calibration_of(stream.trial, options.output)
    rows = list(_camera_rows(stream, calibration, options))
    if camera == CAMERAS[0]:
        rows += list(decoder_rows(stream.events, options.output))
    part = {"rate_hz": stream.rate_hz, "rows": [asdict(row) for row in rows]}
    write_json(path, part)
    return part


def _tables(rows: list[Row]) -> list[Table]:
    decoding = tuple(row.metric for row in rows if row.case == "all")
    methods: tuple[str, ...] = (*OWN, *PEERS)
    wanted: list[tuple[str, tuple[str, ...], tuple[str, ...]]] = [
        (camera, tuple(DEFINITIONS), methods) for camera in CAMERAS
    ]
    wanted.append(("all", decoding, ("decoder",)))
    return [
        Table(name=case, title=case, case=case, metrics=metrics, methods=methods)
        for case, metrics, methods in wanted
    ]


def paced_process(
    queue: Any, name: str, camera: str, options: tuple[int, int, float], folder: Path
) -> None:
    """Do the paced run of one method; the body of its own process.

    Args:
        queue: Takes the latencies, us.
        name: Method.
        camera: Preset of the stream.
        options: Seed, turns, duration in s.
        folder: With the calibrations.
    """
    seed, turns, duration_s = options
    stream = kept_stream(camera, seed, turns, folder)
    calibration = calibration_of(stream.trial, folder)
    gc.disable()
    windows = windows_of(stream, PACE_US)
    queue.put(paced_run(main_methods()[name].build, calibration, windows, duration_s))


def _camera_rows(
    stream: BenchStream, calibration: Calibration, options: RunOptions
) -> Iterator[Row]:
    camera, methods = stream.trial.camera, main_methods()
    windows = windows_of(stream, PACE_US)
    at_1khz: dict[str, FreeRun] = {}
    for name in OWN:
        at_1khz[name] = free_run(methods[name].build(calibration), windows, stream)
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
            values |= _paced(name, camera, options)
        for metric, value in values.items():
            yield _row(name, camera, metric, value, len(own.step_us))


def _paced(name: str, camera: str, options: RunOptions) -> dict[str, float]:
    turns = QUICK_TURNS if options.quick else TURNS
    duration_s = QUICK_PACED_S if options.quick else PACED_S
    arguments = (options.seed, turns, duration_s)
    latency_us = in_own_process(paced_process, name, camera, arguments, options.output)
    return {
        "paced_1khz_p99_us": float(np.percentile(latency_us, 99)),
        "paced_1khz_missed": float((latency_us > PACE_US).mean()),
    }


def _row(method: str, case: str, metric: str, value: float, count: int) -> Row:
    return Row(
        method=method,
        case=case,
        metric=metric,
        value=value,
        unit=UNITS.get(metric, "us"),
        n=count,
        source="twin",
        paper=None,
        definition=DEFINITIONS[metric],
    )


def _findings(rows: list[Row]) -> list[str]:
    findings = (_finding(rows, method, camera) for method in OWN for camera in CAMERAS)
    return [finding for finding in findings if finding]


def _finding(rows: list[Row], method: str, camera: str) -> str:
    values = {row.metric: row.value for row in rows if (row.method, row.case) == (method, camera)}
    peer = find_row(rows, "opencv_tuned", camera, "error_mean_px")
    error_px = values.get("error_mean_px")
    if error_px is None or peer is None or not peer.value:
        return ""
    text = (
        f"{method} on {camera}: {values['step_p50_us']:.0f} us a step at the median, "
        f"{values['step_p99_us']:.0f} us at the 99th percentile; "
        f"{values['speedup_vs_opencv_tuned']:.1f} times as fast as tuned OpenCV from map to "
        f"centres, at {error_px / peer.value:.2f} of its error ({error_px:.3f} px)"
    )
    if (late := values.get("paced_1khz_p99_us")) is not None:
        missed = 100.0 * (values["paced_1khz_missed"] or 0.0)
        text += f"; paced at 1 kHz {late:.0f} us at the 99th percentile, {missed:.2f} % missed"
    return text + "."
