"""Rates and latencies: 2 Mev/s, 64 markers, one core, beside tuned peers on the same stream."""

from __future__ import annotations

import gc
import importlib
import importlib.util
import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import Calibration, windows
from spikingtac.config import digest
from spikingtac.events import create_events, open_events
from spikingtac.state_map import BinaryStateMap
from spikingtac.types import EventPacket, FloatArray
from spikingtac_paper.harness.report import Metric, Report, Row, by_name, lines_of, write_report
from spikingtac_paper.harness.run import Record, RunOptions, code_digest, kept
from spikingtac_paper.throughput.peers import PEERS
from spikingtac_paper.throughput.stream import (
    PACE_US,
    BenchStream,
    FreeRun,
    bench_stream,
    free_run,
    paced_run,
)
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

ENCODINGS = ("evt2", "evt21", "evt3")

# Runs of each measurement of the decoder; the fastest counts, since other load only makes a run
# slower.
REPEATS = 5
PACKET_US = 10_000  # Length of the packets of the count and map measurement.

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
    settings = options.begin(bench=NAME, seed=options.seed)
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
    name: str, stream: BenchStream, calibration: Calibration, duration_s: float
) -> FloatArray:
    """Return the latencies, us, of the paced run of one method; for a process of its own."""
    gc.disable()
    in_windows = list(windows([stream.events], PACE_US))
    return paced_run(main_methods()[name].build, calibration, in_windows, duration_s)


def _camera_rows(
    camera: str, stream: BenchStream, calibration: Calibration, quick: bool
) -> Iterator[Row]:
    methods, pieces = main_methods(), list(windows([stream.events], PACE_US))
    at_1khz: dict[str, FreeRun] = {
        name: free_run(methods[name].build(calibration), pieces, stream) for name in OWN
    }
    for name, build in PEERS.items():
        at_1khz[name] = free_run(build(calibration), pieces, stream, SLOW_EVERY.get(name, 1))
    peer_us = float(np.median(at_1khz["opencv_tuned"].estimate_us))
    for name, at_pace in at_1khz.items():
        own = at_pace
        if name == "fast":
            fine = list(windows([stream.events], FAST_US))
            own = free_run(methods[name].build(calibration), fine, stream)
        values = {
            "step_p50_us": float(np.median(own.step_us)),
            "step_p99_us": float(np.percentile(own.step_us, 99)),
            "error_mean_px": own.error_px,
            "speedup_vs_opencv_tuned": peer_us / float(np.median(at_pace.estimate_us)),
        }
        if name in PACED:
            duration_s = QUICK_PACED_S if quick else PACED_S
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                call = pool.submit(paced_process, name, stream, calibration, duration_s)
                late_us = call.result()
            values["paced_1khz_p99_us"] = float(np.percentile(late_us, 99))
            values["paced_1khz_missed"] = float((late_us > PACE_US).mean())
        for metric, value in values.items():
            yield METRICS[metric].row(name, camera, value, len(own.step_us))


def decoder_rows(events: EventPacket, folder: Path) -> Iterator[Row]:
    """Yield the rows of the method ``decoder``.

    Args:
        events: The stream.
        folder: Where to write it in each encoding.
    """

    def row(name: str, unit: str, definition: str, value: float) -> Row:
        metric = Metric(name, unit, f"{definition}; fastest of {REPEATS} runs")
        return metric.row("decoder", "all", value, REPEATS)

    millions = len(events) / 1e6
    taken_s = {}
    for encoding in ENCODINGS:
        path = folder / "streams" / f"{encoding}.raw"
        path.parent.mkdir(exist_ok=True)
        with create_events(path, events.size, encoding=encoding) as writer:
            writer.write(events)
        taken_s[encoding] = fastest_s(lambda path=path: [len(part) for part in open_events(path)])
        about = f"{encoding.upper()} file on disk to checked event packets"
        yield row(f"decode_{encoding}_mev_s", "Mev/s", about, millions / taken_s[encoding])
    if importlib.util.find_spec("evt3"):
        from evt3 import decode_file as decode

        library_s = fastest_s(lambda: decode(str(folder / "streams" / "evt3.raw")))
        about = "decode_evt3_mev_s over that of the evt3 package, the same file"
        yield row("decode_vs_evt3_library", "times", about, library_s / taken_s["evt3"])
    about = "events to 1 ms counts and the map, bounds checked"
    packets, state_map = list(windows([events], PACKET_US)), BinaryStateMap(events.size)

    def count() -> None:
        for one in packets:
            state_map.absorb(one)
            edges_us = np.arange(one.t_start_us, one.t_end_us + PACE_US, PACE_US)
            np.diff(np.searchsorted(one.t, edges_us))

    yield row("counts_and_map_mev_s", "Mev/s", about, millions / fastest_s(count))


def fastest_s(action: Callable[[], object]) -> float:
    """Return the least time of several runs after one that is not counted, s."""
    action()
    taken = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return min(taken)
