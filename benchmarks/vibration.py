"""How well vibration is told from events: a skin that shakes on the twin.

    spikingtac simulate bootstrap -o slides && spikingtac calibrate slides -o sensor.json
    python benchmarks/vibration.py sensor.json [--camera typical] [--seed 3]

All markers of the scene ``quiet`` move on a sine of 50 or 5 um for 1.1 s, of which the last
second is judged. The estimator gets events and the calibration, never the truth. At 5 um and at
rest, twelve seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.source import SceneSource
from spikingtac.touch.vibration.event_vibration import EventVibrationMonitor, VibrationLine

FREQUENCIES_HZ = (20, 50, 120, 240, 400, 498)
STRONG_MM, WEAK_MM = 0.05, 0.005
WEAK_HZ, WEAK_SEEDS = 120, 12
DURATION_US, RAMP_US = 1_100_000, 100_000
IMAGES_PER_CYCLE, SHORTEST_US, LONGEST_US = 24, 50.0, 1_000.0


def line_of(
    calibration: Calibration, hz: float, amplitude_mm: float, seed: int, camera: str
) -> VibrationLine | None:
    """Return the line that is heard, for a direction drawn from the seed."""
    scene = catalog.load("quiet").with_camera(camera)
    _, rest = next(SceneSource(scene, seed).frames())
    angle = np.random.default_rng(seed).uniform(0.0, np.pi)
    along = amplitude_mm * scene.optics.px_per_mm * np.array([np.cos(angle), np.sin(angle)])
    step_us = float(np.clip(1e6 / hz / IMAGES_PER_CYCLE, SHORTEST_US, LONGEST_US))

    def images() -> Iterator[MarkerImage]:
        for t_us in np.arange(0.0, DURATION_US, step_us).astype(np.int64).tolist():
            wave = min(1.0, t_us / RAMP_US) * np.sin(2e-6 * np.pi * hz * t_us)
            yield replace(rest, t_us=t_us, center_px=rest.center_px + wave * along)

    monitor = EventVibrationMonitor(calibration)
    for packet in SceneSource(scene, seed).render_images(images()):
        monitor.absorb(packet)
    return monitor.line()


def main() -> None:
    """Print the errors of 50 um, and how often 5 um and rest are told apart."""
    parser = argparse.ArgumentParser(description="How well vibration is told from events")
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--camera", default="typical")
    parser.add_argument("--seed", type=int, default=3)
    args = parser.parse_args()
    calibration = Calibration.load(args.calibration)
    true_px = STRONG_MM * catalog.load("quiet").optics.px_per_mm
    for hz in FREQUENCIES_HZ:
        line = line_of(calibration, hz, STRONG_MM, args.seed, args.camera)
        if line is None or line.amplitude_px is None or line.sigma_px is None:
            print(f"{hz} Hz: nothing heard")
            continue
        error, sigma = line.amplitude_px / true_px - 1.0, line.sigma_px / true_px
        print(f"{hz} Hz: {line.hz - hz:+.2f} Hz, amplitude {error:+.1%} (own error {sigma:.1%})")
    for amplitude_mm in (WEAK_MM, 0.0):
        lines = [
            line_of(calibration, WEAK_HZ, amplitude_mm, seed, args.camera)
            for seed in range(WEAK_SEEDS)
        ]
        heard = sum(line is not None and abs(line.hz - WEAK_HZ) < 1.0 for line in lines)
        others = sum(line is not None for line in lines) - heard
        print(
            f"{1e3 * amplitude_mm:g} um: heard in {heard} of {WEAK_SEEDS} seconds, {others} wrong"
        )


if __name__ == "__main__":
    main()
