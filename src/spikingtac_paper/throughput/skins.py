"""How the cost of a step grows: 64, 256, 1,024 markers; 2, 10, 50 Mev/s (simulated)."""

from __future__ import annotations

import gc
import time
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from spikingtac import Calibration, windows
from spikingtac.sim import Scene, load_scene
from spikingtac_paper.harness.report import (
    Metric,
    Report,
    Row,
    by_name,
    lines_of,
    write_report,
)
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.throughput.stream import (
    PACE_US,
    US_PER_S,
    BenchStream,
    circling,
    free_run,
    turns_for,
)
from spikingtac_paper.trials.methods import main_methods

NAME = "skins"
METHODS = ("default", "fast")
RATES_MEV_S = (2, 10, 50)
DURATION_US, QUICK_DURATION_US = 400_000, 120_000

# Distance of the lens: a wide skin is seen without distortion, so that all its markers are alike.
FAR_MM = 200.0
TRY_US = 50_000  # Length of a trial, from which the speed for the wanted rate follows, us.
FIRST_TURNS_HZ = 2.0  # Circles per second of the first trial, for 64 markers and 1 Mev/s.
METRICS = by_name(
    Metric("step_p50_us", "us", "median of absorb + estimate, every ms, free running"),
    Metric("step_p99_us", "us", "99th percentile of the same"),
    Metric("absorb_mev_s", "Mev/s", "events per window over the median time to absorb them"),
    Metric("start_s", "s", "time to make the tracker"),
    Metric("error_mean_px", "px", "mean distance of detected_px to the truth over the stream"),
    Metric("events_mev_s", "Mev/s", "events of the stream per second"),
)


class Skin(NamedTuple):
    """A skin and its sensor.

    Attributes:
        grid: ``(rows, columns)`` of markers.
        size: ``(width, height)`` of the sensor, px.
        px_per_mm: Scale of the image; the markers' pitch is 2.4 mm.
        radius_mm: Radius of the discs.
    """

    grid: tuple[int, int]
    size: tuple[int, int]
    px_per_mm: float
    radius_mm: float

    @property
    def markers(self) -> int:
        """Number of markers."""
        return self.grid[0] * self.grid[1]

    def scene(self) -> Scene:
        """Return the skin at rest before the camera preset ``typical``."""
        scene = load_scene("quiet")
        lens = replace(
            scene.optics,
            size=self.size,
            px_per_mm=self.px_per_mm,
            distance_mm=FAR_MM,
            k1=0.0,
            discs=replace(scene.optics.discs, radius_mm=self.radius_mm),
        )
        return replace(scene, optics=lens, skin=replace(scene.skin, grid=self.grid))


SKINS = (
    Skin((8, 8), (320, 320), 15.5, 0.45),
    Skin((16, 16), (640, 640), 15.5, 0.45),
    # The sensor's height allows a pitch of 22 px; discs of 6 px leave 10 px between them.
    Skin((32, 32), (1280, 720), 9.2, 0.65),
)


def skin_stream(skin: Skin, rate_mev_s: float, seed: int, duration_us: int) -> BenchStream:
    """Simulate a skin in motion without the cap of the camera's readout.

    Args:
        skin: Which one.
        rate_mev_s: Wanted events, million per second.
        seed: Of the camera's noise.
        duration_us: Length, us.
    """
    scene, guess_hz = skin.scene(), FIRST_TURNS_HZ * rate_mev_s * SKINS[0].markers / skin.markers
    turns_hz = turns_for(scene, seed, rate_mev_s * 1e6, guess_hz, TRY_US, capped=False)
    return circling(scene, seed, turns_hz, duration_us, capped=False)


def run(options: RunOptions) -> dict[str, Any]:
    """Run the bench, write its report, and return a summary."""
    settings = {"bench": NAME, "quick": options.quick, "seed": options.seed}
    options.begin(settings)
    duration_us = QUICK_DURATION_US if options.quick else DURATION_US
    rows: list[Row] = []
    cases = list(product(SKINS, RATES_MEV_S))
    for number, (skin, rate) in enumerate(cases, 1):
        stream = skin_stream(skin, rate, options.seed, duration_us)
        for method in METHODS:
            rows += [
                METRICS[name].row(method, f"{skin.markers}@{rate}", value, duration_us // PACE_US)
                for name, value in _measured(method, skin, stream).items()
            ]
        options.report_progress(number, len(cases))
    report = Report(
        title="Big skins",
        settings=settings,
        rows=rows,
        findings=lines_of(rows, dict.fromkeys(row.case for row in rows), METHODS),
    )
    return write_report(report, options)


def _measured(method: str, skin: Skin, stream: BenchStream) -> dict[str, float]:
    pieces, build = list(windows([stream.events], PACE_US)), main_methods()[method].build
    calibration = Calibration(
        reference_px=stream.truth.reference_px,
        radius_px=stream.truth.radius_px,
        grid=skin.grid,
        size=skin.size,
    )
    free_run(build(calibration), pieces[:20], stream)  # compiles, and fills the caches
    begun_s = time.perf_counter()
    tracker = build(calibration)
    start_s = time.perf_counter() - begun_s
    gc.collect()
    gc.disable()
    try:
        found = free_run(tracker, pieces, stream)
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
