"""Calibrate and track press recordings of other sensors, by a model that knows no package code.

    python benchmarks/press_sensors.py [SENSOR ...] [--methods default fast] [--keep FOLDER]

Every pixel follows the logarithm of a blurred disc and fires when it has left its last level by a
threshold. Sensors differ in thresholds (ON rarer, OFF rarer, equal), contrasts, edges, number of
presses and grid. Nothing but the recording reaches ``calibrate``; errors are against truth, px, of
the measured markers. Simulated; the kind of recording is that of docs/explanation/real-gels.md.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import SpikingTacError
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow

SIZE = (240, 180)
STEP_US = 1_000
NOISE_HZ = 100.0
MISMATCH = 0.12
SPREAD_PX = 14.0
"""Largest displacement under a press."""
CREEP_SHARE, CREEP_S = 0.04, 1.0
"""What a press leaves behind, as a share of itself, and how fast it goes."""
OVERSHOOT_S = 0.02
"""How long a release goes too far."""
MOST_GROWTH = 0.3
"""Share of a radius within which all of a grown disc is drawn."""
MOST_EVENTS = 30_000_000
BEFORE = np.concatenate([np.linspace(0, 1, 300), np.linspace(1, 0, 300)])
"""Course of a press before the recording: what a pixel's last level was is not known."""
RATE_HZ = 500.0
LOST_PX = 5.0


@dataclass(frozen=True)
class Sensor:
    """One sensor and its recording; thresholds in the logarithm of light.

    Light that a pixel lost without an event is forgotten within ``recovery_s`` (0: never), and a
    release goes too far by a share ``overshoot`` of its way, for some 20 ms. Discs near a press
    grow by up to a share ``growth``.
    """

    seed: int
    threshold_on: float = 0.15
    threshold_off: float = 0.42
    grid: tuple[int, int] = (5, 7)
    pitch_px: tuple[float, float] = (34.5, 38.0)
    first_px: tuple[float, float] = (17.0, 15.0)
    radius_px: float = 5.8
    contrast: tuple[float, float] = (2.0, 5.0)
    edge_px: tuple[float, float] = (0.7, 1.3)
    presses: int = 12
    recovery_s: float = 0.0
    overshoot: float = 0.0
    growth: float = 0.0


SENSORS = {
    "usual": Sensor(1),
    "larger": Sensor(2, 0.20, 0.50),
    "sparse": Sensor(3, 0.25, 0.60, (2, 4), (60.0, 70.0), (30.0, 50.0), 9.0),
    "equal": Sensor(4, 0.30, 0.30),
    "fine": Sensor(5, 0.10, 0.50),
    "on-rarer": Sensor(6, 0.35, 0.18),
    "few": Sensor(7, presses=4),
    "forgetful": Sensor(
        9, 0.17, 0.24, radius_px=5.3, edge_px=(1.3, 2.0), recovery_s=0.2, overshoot=0.2
    ),
    "forgetful-few": Sensor(
        10, 0.15, 0.27, radius_px=5.3, edge_px=(1.2, 1.9), presses=4, recovery_s=0.3, overshoot=0.1
    ),
    "forgetful-growing": Sensor(
        11,
        0.16,
        0.25,
        radius_px=5.2,
        edge_px=(1.3, 2.0),
        recovery_s=0.2,
        overshoot=0.1,
        growth=0.2,
    ),
    "sparse-small": Sensor(8, 0.22, 0.55, (2, 4), (58.0, 75.0), (30.0, 45.0), 6.0),
}


@njit(cache=True)
def light_kernel(
    x: int,
    y: int,
    center_px: NDArray[np.float64],
    look: NDArray[np.float64],
    growth: NDArray[np.float64],
) -> float:
    """Return the logarithm of a pixel's light; ``look`` is radius, edge scale (px) and contrast.

    ``growth`` is by which share each radius has grown.
    """
    brightest = 0.0
    for m in range(len(center_px)):
        dx, dy = x - center_px[m, 0], y - center_px[m, 1]
        if abs(dx) < 25.0 and abs(dy) < 25.0:
            radius_px = look[m, 0] * (1.0 + growth[m])
            beyond = (np.sqrt(dx * dx + dy * dy) - radius_px) / (0.55 * look[m, 1])
            brightest = max(brightest, (look[m, 2] - 1.0) / (1.0 + np.exp(beyond)))
    return np.log1p(brightest)


@njit(cache=True)
def record_kernel(
    course_px: NDArray[np.float64],
    growth: NDArray[np.float64],
    look: NDArray[np.float64],
    thresholds: NDArray[np.float64],
    level: NDArray[np.float64],
    recovery_s: float,
    out: tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.bool_]],
) -> int:
    """Write the events of a course, unsorted within a step; return how many there are."""
    t, x_out, y_out, p_out = out
    height, width = level.shape
    light, n = level.copy(), 0
    lit_at = np.zeros(level.shape, np.int64)
    for s in range(1, len(course_px)):
        for m in range(course_px.shape[1]):
            here, before = course_px[s, m], course_px[s - 1, m]
            if abs(here[0] - before[0]) + abs(here[1] - before[1]) < 1e-5:
                continue
            reach = (1.0 + MOST_GROWTH) * look[m, 0] + 5.0 * look[m, 1] + 2.0
            for y in range(max(0, int(here[1] - reach)), min(height, int(here[1] + reach) + 2)):
                for x in range(max(0, int(here[0] - reach)), min(width, int(here[0] + reach) + 2)):
                    old = light[y, x]
                    new = light_kernel(x, y, course_px[s], look, growth[s])
                    light[y, x] = new
                    if recovery_s > 0.0 and level[y, x] > old:
                        kept = np.exp(-(s - lit_at[y, x]) * STEP_US * 1e-6 / recovery_s)
                        level[y, x] = old + kept * (level[y, x] - old)
                    lit_at[y, x] = s
                    rising = new > old
                    step = thresholds[1, y, x] if rising else -thresholds[0, y, x]
                    while abs(new - level[y, x]) > abs(step) and (new > level[y, x]) == rising:
                        level[y, x] += step
                        share = min(max((level[y, x] - old) / (new - old), 0.0), 1.0)
                        t[n], p_out[n] = int((s - 1 + share) * STEP_US), rising
                        x_out[n], y_out[n] = x, y
                        n += 1
    return n


def pushed_px(
    rest_px: NDArray[np.float64], place_px: NDArray[np.float64], most_px: float, width_px: float
) -> NDArray[np.float64]:
    """Return ``(m, 2)`` by how far a press at a place spreads the markers, px."""
    away = (rest_px - place_px) / width_px
    return most_px * away * np.exp(0.5 - 0.5 * (away**2).sum(axis=1, keepdims=True))


def presses_px(
    rest_px: NDArray[np.float64], presses: int, overshoot: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``(steps, m, 2)`` where the markers are, and ``(steps, m)`` how deep they are pressed.

    Creep is left after each press; depths are shares of the deepest.
    """
    begin_s = 1.5 + np.cumsum(rng.uniform(3.0, 4.2, presses))
    at_s = np.arange(0.0, begin_s[-1] + 4.0, STEP_US * 1e-6)
    course_px = np.repeat(rest_px[np.newaxis], len(at_s), axis=0)
    depth = np.zeros(course_px.shape[:2])
    for first_s in begin_s - 3.0:
        on_s, hold_s, off_s = rng.uniform((0.15, 0.9, 0.15), (0.3, 1.5, 0.35))
        place_px = rng.uniform(0.2, 0.8, 2) * SIZE
        most_px, width_px = rng.uniform(0.6, 1) * SPREAD_PX, rng.uniform(35, 60)
        field_px = pushed_px(rest_px, place_px, most_px, width_px)
        risen = ((at_s - first_s) / on_s).clip(0.0, 1.0)
        last_s = first_s + on_s + hold_s
        left = 1.0 - (1.0 - CREEP_SHARE) * ((at_s - last_s) / off_s).clip(0.0, 1.0)
        left *= np.exp(-(at_s - last_s - off_s).clip(0.0) / CREEP_S)
        left -= overshoot * np.exp(-(((at_s - last_s - off_s) / OVERSHOOT_S) ** 2))
        course_px += (risen * left)[:, np.newaxis, np.newaxis] * field_px
        near = np.exp(-0.5 * (((rest_px - place_px) / width_px) ** 2).sum(axis=1))
        depth += np.outer((risen * left).clip(0.0), most_px / SPREAD_PX * near)
    return course_px, depth


def smooth(
    rest_px: NDArray[np.float64],
    size: tuple[int, int],
    bounds: tuple[float, float],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return a tilted plane over the skin with a little scatter, between two bounds."""
    plane = (rest_px / size - 0.5) @ rng.uniform(-1, 1, 2) + rng.normal(0.0, 0.08, len(rest_px))
    share = (plane - plane.min()) / (plane.max() - plane.min())
    return bounds[0] + share * (bounds[1] - bounds[0])


def events_of(
    paths_px: tuple[NDArray[np.float64], NDArray[np.float64]],
    growth: NDArray[np.float64],
    look: NDArray[np.float64],
    thresholds: NDArray[np.float64],
    recovery_s: float,
) -> list[NDArray]:
    """Return times, columns, rows and polarities of the events of :data:`BEFORE` and a course.

    Args:
        paths_px: ``(m, 2)`` how far the press before goes, ``(steps, m, 2)`` the course, px.
        growth: ``(steps, m)`` by which share radii grow along the course.
        look: ``(m, 3)`` radius, edge scale (px) and contrast.
        thresholds: ``(2, height, width)`` OFF and ON, in the logarithm of light.
        recovery_s: See :class:`Sensor`.
    """
    before_px, course_px = paths_px
    rest_px, (height, width) = course_px[0], thresholds.shape[1:]
    there_px = rest_px + BEFORE[:, np.newaxis, np.newaxis] * before_px
    whole_px = np.concatenate([there_px, course_px])
    grown = np.concatenate([np.zeros((len(BEFORE), len(rest_px))), growth])
    rows, columns = range(height), range(width)
    level = np.array([[light_kernel(x, y, rest_px, look, grown[0]) for x in columns] for y in rows])
    types = np.int64, np.uint16, np.uint16, np.bool_
    out = tuple(np.empty(MOST_EVENTS, kind) for kind in types)
    count = record_kernel(whole_px, grown, look, thresholds, level, recovery_s, out)
    return [column[:count] for column in out]


def write_events(
    path: Path,
    parts: tuple[list[NDArray], list[NDArray]],
    size: tuple[int, int],
    dark: bool = False,
) -> None:
    """Write what comes after :data:`BEFORE` of events and noise; dark markers swap polarities."""
    t, x, y, p = (
        np.concatenate([part, more.astype(part.dtype)]) for part, more in zip(*parts, strict=True)
    )
    t -= len(BEFORE) * STEP_US
    order = np.argsort(t, kind="stable")
    order = order[t[order] >= 0]
    np.savez(path, t=t[order], x=x[order], y=y[order], p=p[order] != dark, size=np.array(size))


def record(sensor: Sensor, path: Path) -> tuple[NDArray, NDArray]:
    """Write a recording; return its course ``(steps, m, 2)`` and rests ``(m, 2)``, px."""
    rng = np.random.default_rng(sensor.seed)
    rows, columns = sensor.grid
    nodes = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    rest_px = sensor.first_px + nodes * sensor.pitch_px + rng.uniform(-1.6, 1.6, nodes.shape)
    look = np.column_stack(
        [
            rng.normal(sensor.radius_px, 0.35, len(rest_px)),
            smooth(rest_px, SIZE, sensor.edge_px, rng),
            smooth(rest_px, SIZE, sensor.contrast, rng),
        ]
    )
    course_px, depth = presses_px(rest_px, sensor.presses, sensor.overshoot, rng)
    before_px = pushed_px(rest_px, rng.uniform(0.2, 0.8, 2) * SIZE, 0.8 * SPREAD_PX, 45.0)
    usual = np.array([sensor.threshold_off, sensor.threshold_on])[:, np.newaxis, np.newaxis]
    thresholds = usual * rng.normal(1.0, MISMATCH, (2, SIZE[1], SIZE[0])).clip(0.3, 3.0)
    paths_px = before_px, course_px
    events = events_of(paths_px, sensor.growth * depth, look, thresholds, sensor.recovery_s)
    duration_us = (len(BEFORE) + len(course_px)) * STEP_US
    count = rng.poisson(NOISE_HZ * duration_us * 1e-6)
    noise = [rng.integers(most, size=count) for most in (duration_us, *SIZE, 2)]
    write_events(path, (events, noise), SIZE)
    return course_px, rest_px


def nearest_rests(
    calibration: Calibration, rest_px: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return which marker each calibrated one is; how far off the measured ones are, px."""
    apart_px = np.linalg.norm(calibration.reference_px[:, np.newaxis] - rest_px, axis=2)
    return apart_px.argmin(axis=1), apart_px.min(axis=1)[calibration.marker_measured]


def errors_px(
    path: Path, calibration: Calibration, method: str, course_px: NDArray, rate_hz: float
) -> NDArray[np.float64]:
    """Return ``(n, k)`` errors of the measured markers; the course is of the calibrated ones."""
    tracker = make_tracker(load_config(method).tracking, calibration)
    error_px = []
    for frame in follow(open_events(path), tracker, rate_hz):
        at = min(frame.t_us / STEP_US, len(course_px) - 1.001)
        part = at - int(at)
        true_px = (1 - part) * course_px[int(at)] + part * course_px[int(at) + 1]
        error_px.append(np.linalg.norm(frame.detected_px - true_px, axis=1))
    return np.array(error_px)[:, calibration.marker_measured]


def tracked(path: Path, calibration: Calibration, method: str, course_px: NDArray) -> str:
    """Return the errors of a method in words; ``course_px`` is of the calibrated markers."""
    error = errors_px(path, calibration, method, course_px, RATE_HZ)
    return (
        f"{method} mean {error.mean():.3f} p95 {np.percentile(error, 95):.3f} "
        f"max {error.max():.2f} lost {int((error.max(axis=0) > LOST_PX).sum())}"
    )


def report(name: str, folder: Path, methods: list[str]) -> str:
    path = folder / f"{name}.npz"
    course_px, rest_px = record(SENSORS[name], path)
    try:
        calibration = calibrate(open_events(path), CalibrationConfig())
    except SpikingTacError as error:
        return f"{name}: {type(error).__name__}: {error}"
    which, wrong_px = nearest_rests(calibration, rest_px)
    lines = [
        f"{name}: {len(rest_px)} markers, {len(wrong_px)} measured in {calibration.grid}, "
        f"rests {wrong_px.mean():.3f} px, at worst {wrong_px.max():.2f}"
    ]
    lines += [tracked(path, calibration, m, course_px[:, which]) for m in methods]
    return "\n    ".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sensors", nargs="*", metavar="SENSOR", help=", ".join(SENSORS))
    parser.add_argument("--methods", nargs="+", default=["default", "fast"])
    parser.add_argument("--keep", type=Path, help="folder for the recordings")
    options = parser.parse_args()
    if unknown := set(options.sensors) - set(SENSORS):
        parser.error(f"no sensor {', '.join(sorted(unknown))}; there are {', '.join(SENSORS)}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.sensors or SENSORS:
            print(report(name, folder, options.methods), flush=True)


if __name__ == "__main__":
    main()
