"""Calibrate and track press recordings of sensors drawn at random, seed by seed.

    python benchmarks/random_sensors.py FIRST LAST [--without-hot-pixels] [--keep FOLDER]

Pixels and presses are those of ``press_sensors.py``, which knows no package code. What differs from
sensor to sensor is drawn from wide ranges: size, grid, turn, barrel distortion, a missing marker,
radius, contrast, edges, thresholds, recovery, growth, dark markers, noise up to 0.7 Hz/px of which
60 % is ON, up to three hot pixels of 50 to 3,000 Hz, shear, and the number of presses. Some of
these sensors are too poor for anything. One line each: markers measured and drawn, rests (mean,
worst), errors (mean, p95, worst) of each method, px. Simulated.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from press_sensors import (
    BEFORE,
    STEP_US,
    errors_px,
    events_of,
    nearest_rests,
    pushed_px,
    smooth,
    write_events,
)

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import SpikingTacError
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate

SIZES = ((240, 180), (320, 320), (346, 260), (320, 240))
ON_NOISE = 0.6
RATE_HZ = 250.0


@dataclass(frozen=True)
class Drawn:
    """One sensor, as ``press_sensors.Sensor`` names things, and what that does not know.

    Lengths are in px; ``noise_hz`` is that of all pixels together, ``turn`` in rad, ``barrel`` the
    share by which half a width is shortened, ``shear_px`` how far a press drags.
    """

    size: tuple[int, int]
    pitch_px: float
    grid: tuple[int, int]
    radius_px: float
    contrast: tuple[float, float]
    edge_px: tuple[float, float]
    threshold_on: float
    threshold_off: float
    presses: int
    recovery_s: float
    overshoot: float
    growth: float
    turn: float
    dark: bool
    noise_hz: float
    hot_pixels: int
    spread_px: float
    shear_px: float
    missing: bool
    barrel: float
    jitter_px: float


def draw(seed: int) -> Drawn:
    """Draw a sensor; the same for a seed."""
    rng = np.random.default_rng(1_000 + seed)
    width, height = SIZES[rng.integers(len(SIZES))]
    pitch_px = rng.uniform(22, 60)
    columns = int(min(10, max(3, (width - 10) // pitch_px)))
    rows = int(min(10, max(2, (height - 10) // pitch_px)))
    radius_px = float(np.clip(pitch_px * rng.uniform(0.14, 0.30), 3.2, 13.0))
    contrast = np.exp(rng.uniform(np.log(1.5), np.log(4.0)))
    most_contrast = min(contrast * rng.uniform(1.2, 3.0), 12.0)
    edge_px = rng.uniform(0.5, 1.5)
    threshold_on = np.exp(rng.uniform(np.log(0.1), np.log(0.35)))
    threshold_off = threshold_on * np.exp(rng.uniform(np.log(0.5), np.log(3.2)))
    most_edge_px = edge_px * rng.uniform(1.0, 1.8)
    return Drawn(
        size=(width, height),
        pitch_px=pitch_px,
        grid=(rows, columns),
        radius_px=radius_px,
        contrast=(contrast, most_contrast),
        edge_px=(edge_px, most_edge_px),
        threshold_on=threshold_on,
        threshold_off=threshold_off,
        presses=int(rng.integers(3, 11)),
        recovery_s=float(rng.choice([0.0, 0.0, 0.2, 0.5])),
        overshoot=float(rng.choice([0.0, 0.0, 0.1])),
        growth=float(rng.choice([0.0, 0.0, 0.15])),
        turn=float(np.deg2rad(rng.choice([0, 1, 1]) * rng.uniform(-8.0, 8.0))),
        dark=bool(rng.random() < 0.3),
        noise_hz=float(np.exp(rng.uniform(np.log(50), np.log(30_000)))),
        hot_pixels=int(rng.integers(0, 4)),
        spread_px=float(min(pitch_px * 0.45, rng.uniform(6.0, 16.0))),
        shear_px=float(rng.choice([0, 1]) * rng.uniform(0.0, 8.0)),
        missing=bool(rng.random() < 0.25),
        barrel=float(rng.choice([0, 1]) * rng.uniform(0.0, 0.08)),
        jitter_px=float(pitch_px * rng.uniform(0.0, 0.05)),
    )


def rests_px(sensor: Drawn, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return ``(m, 2)`` where the markers rest: those that the image shows."""
    (rows, columns), size = sensor.grid, np.array(sensor.size)
    across, down = np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2
    nodes_px = np.stack(np.meshgrid(across, down), -1).reshape(-1, 2) * sensor.pitch_px
    cos, sin = np.cos(sensor.turn), np.sin(sensor.turn)
    nodes_px = nodes_px @ np.array([[cos, sin], [-sin, cos]])
    square = (nodes_px**2).sum(axis=1, keepdims=True) / (size[0] / 2) ** 2
    jitter_px = rng.uniform(-sensor.jitter_px, sensor.jitter_px, nodes_px.shape)
    all_px = nodes_px * (1.0 - sensor.barrel * square) + (size - 1) / 2 + jitter_px
    margin_px = 0.6 * sensor.radius_px
    shown = ((all_px > margin_px) & (all_px < size - margin_px)).all(axis=1)
    if sensor.missing:
        shown[rng.integers(len(shown))] = False
    return all_px[shown]


def presses_px(
    sensor: Drawn, rest_px: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``(steps, m, 2)`` where the markers are, and ``(steps, m)`` how deep they are pressed.

    A press before the recording comes first.
    """
    begin_s = 1.5 + np.cumsum(rng.uniform(1.6, 2.6, sensor.presses))
    at_s = np.arange(0.0, begin_s[-1] + 1.5, STEP_US * 1e-6)
    course_px = np.repeat(rest_px[np.newaxis], len(at_s), axis=0)
    depth = np.zeros(course_px.shape[:2])
    for first_s in begin_s - 1.6:
        on_s, hold_s, off_s = rng.uniform((0.1, 0.3, 0.1), (0.3, 0.9, 0.35))
        place_px = rng.uniform(0.2, 0.8, 2) * sensor.size
        most_px = rng.uniform(0.6, 1.0) * sensor.spread_px
        width_px = rng.uniform(0.15, 0.3) * sensor.size[0]
        near = np.exp(-0.5 * (((rest_px - place_px) / width_px) ** 2).sum(axis=1))
        drag_px = sensor.shear_px * rng.normal(size=2) * np.sqrt(near)[:, np.newaxis]
        last_s = first_s + on_s + hold_s
        left = 1.0 - 0.96 * ((at_s - last_s) / off_s).clip(0.0, 1.0)
        left *= np.exp(-(at_s - last_s - off_s).clip(0.0))
        left -= sensor.overshoot * np.exp(-(((at_s - last_s - off_s) / 0.02) ** 2))
        pressed = ((at_s - first_s) / on_s).clip(0.0, 1.0) * left
        dragged = ((at_s - first_s - on_s) / max(hold_s, 0.1)).clip(0.0, 1.0) * left
        field_px = pushed_px(rest_px, place_px, most_px, width_px)
        course_px += pressed[:, np.newaxis, np.newaxis] * field_px
        course_px += dragged[:, np.newaxis, np.newaxis] * drag_px
        depth += np.outer(pressed.clip(0.0), most_px / sensor.spread_px * near)
    return course_px, depth


def noise_events(
    sensor: Drawn, duration_us: int, hot_pixels: int, rng: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Return times, columns, rows and polarities of the noise and of the hot pixels."""
    count = rng.poisson(sensor.noise_hz * duration_us * 1e-6)
    t, x, y = (rng.integers(most, size=count) for most in (duration_us, *sensor.size))
    parts = [[t, x, y, (rng.random(count) < ON_NOISE).astype(np.int64)]]
    for _ in range(hot_pixels):
        count = int(rng.uniform(50, 3_000) * duration_us * 1e-6)
        t = rng.integers(duration_us, size=count)
        place = [np.full(count, rng.integers(most)) for most in sensor.size]
        parts.append([t, *place, (rng.random(count) < 0.5).astype(np.int64)])
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def record(
    sensor: Drawn, seed: int, hot_pixels: int, path: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Write a recording; return its course ``(steps, m, 2)`` and rests ``(m, 2)``, px."""
    rng = np.random.default_rng(seed)
    rest_px, (width, height) = rests_px(sensor, rng), sensor.size
    look = np.column_stack(
        [
            rng.normal(sensor.radius_px, 0.04 * sensor.radius_px, len(rest_px)),
            smooth(rest_px, sensor.size, sensor.edge_px, rng),
            smooth(rest_px, sensor.size, sensor.contrast, rng),
        ]
    )
    course_px, depth = presses_px(sensor, rest_px, rng)
    before_px = pushed_px(
        rest_px, rng.uniform(0.2, 0.8, 2) * sensor.size, 0.8 * sensor.spread_px, 0.2 * width
    )
    # Dark markers send what white ones of swapped thresholds and polarities do.
    usual = np.array([sensor.threshold_off, sensor.threshold_on])[:: -1 if sensor.dark else 1]
    mismatch = rng.normal(1.0, 0.1, (2, height, width)).clip(0.3, 3.0)
    thresholds = usual[:, np.newaxis, np.newaxis] * mismatch
    paths_px = before_px, course_px
    events = events_of(paths_px, sensor.growth * depth, look, thresholds, sensor.recovery_s)
    duration_us = (len(BEFORE) + len(course_px)) * STEP_US
    noise = noise_events(sensor, duration_us, hot_pixels, rng)
    write_events(path, (events, noise), sensor.size, sensor.dark)
    return course_px, rest_px


def errors(path: Path, calibration: Calibration, method: str, course_px: NDArray) -> str:
    """Return the errors of a method in words; ``course_px`` is of the calibrated markers."""
    error = errors_px(path, calibration, method, course_px, RATE_HZ)
    return f"{method} {error.mean():.3f} {np.percentile(error, 95):.3f} {error.max():.2f}"


def report(seed: int, hot: bool, folder: Path) -> str:
    """Return a line of results."""
    sensor, path = draw(seed), folder / f"{seed}.npz"
    course_px, rest_px = record(sensor, seed, sensor.hot_pixels if hot else 0, path)
    try:
        calibration = calibrate(open_events(path))
    except SpikingTacError as error:
        return f"{seed}: {len(rest_px)} markers; {str(error).split(';')[0]}"
    which, wrong_px = nearest_rests(calibration, rest_px)
    methods = [errors(path, calibration, m, course_px[:, which]) for m in ("default", "fast")]
    return (
        f"{seed}: {len(wrong_px)} of {len(rest_px)} markers, rests {wrong_px.mean():.3f} "
        f"{wrong_px.max():.2f}; {'; '.join(methods)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="first seed")
    parser.add_argument("last", type=int, help="last seed")
    parser.add_argument("--without-hot-pixels", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder for the recordings")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in range(options.first, options.last + 1):
            print(report(seed, not options.without_hot_pixels, folder), flush=True)


if __name__ == "__main__":
    main()
