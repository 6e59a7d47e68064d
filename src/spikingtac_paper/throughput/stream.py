"""Streams of the benches, a skin that moves on a circle, and a tracker's timed steps on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spikingtac import Calibration, MarkerTracker
from spikingtac.sim import EventCamera, Optics, Scene, image_radius_px, load_scene
from spikingtac.types import US_PER_S, EventPacket, FloatArray
from spikingtac_paper.trials.trajectories import GroundTruth

TARGET_HZ = 2.0e6  # Events per second of the throughput bench: a busy tactile recording.
CIRCLE_MM = 0.33  # Radius of the circle, mm: about 5 px.
FIRST_GUESS_HZ = 4.0  # Circles per second of the first trial; the rate of events grows with it.
IMAGE_US = 1_000  # Time between two images, us; the camera moves the markers linearly in between.
TRY_US = 500_000  # Length of a trial, us.
PACE_US = 1_000  # Period of the paced run: 1 kHz.

# Fraction of the steps that runs first and is not timed: kernels compile, caches fill.
WARM_UP_SHARE = 0.1

# Noise and dead time make the rate less than proportional: after one trial it is 5 % low.
TRIES = 2


class BenchStream(NamedTuple):
    """Events and truth of a skin that moves on a circle.

    Attributes:
        events: All events, from time 0 on.
        truth: Where the markers were.
        rate_hz: Events per second.
    """

    events: EventPacket
    truth: GroundTruth
    rate_hz: float


def bench_stream(camera: str, seed: int, turns: int) -> BenchStream:
    """Return whole turns of the default skin, so that they can be repeated without a jump.

    Args:
        camera: ``typical`` or ``noisy``.
        seed: Of the camera's noise.
        turns: Number of full circles.
    """
    scene = load_scene("quiet").with_camera(camera).with_serial(1)
    turns_hz = FIRST_GUESS_HZ
    for _ in range(TRIES):
        turns_hz *= TARGET_HZ / _circling(scene, seed, turns_hz, TRY_US).rate_hz
    turn_us = IMAGE_US * round(1e6 / turns_hz / IMAGE_US)
    return _circling(scene, seed, 1e6 / turn_us, turns * turn_us)


def _circling(scene: Scene, seed: int, turns_hz: float, duration_us: int) -> BenchStream:
    """Return the events and the truth of a scene's skin that moves on a circle as a whole."""
    serial, optics = scene.skin.serial, Optics(scene.optics, seed=scene.skin.serial)
    camera = EventCamera(scene.camera.resolve(), scene.size, seed, serial=serial)
    times_us = np.arange(0, duration_us + 1, IMAGE_US)
    angle = 2.0 * np.pi * turns_hz * 1e-6 * times_us
    # Leaves the rest smoothly: the circle passes through it.
    way_mm = CIRCLE_MM * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle])
    rest = scene.skin.at_rest()
    images = [
        optics.project(replace(rest, t_us=t_us, marker_mm=rest.marker_mm + way))
        for t_us, way in zip(times_us.tolist(), way_mm, strict=True)
    ]
    camera.settle(images[0], scene.history.references)
    events = EventPacket.concatenate([camera.advance([one]) for one in images[1:]])
    centers_px = np.array([one.center_px for one in images])
    radius_px, last_us = image_radius_px(images[0]), int(times_us[-1])
    truth = GroundTruth(times_us, centers_px, centers_px[0], radius_px, last_us)
    return BenchStream(events, truth, len(events) / (duration_us * 1e-6))


class FreeRun(NamedTuple):
    """Steps of a tracker that never waits.

    Attributes:
        step_us: ``(n,)`` absorb and estimate together, us.
        estimate_us: ``(n,)`` the estimate alone: map to centres, us.
        error_px: Mean error against the truth, px.
    """

    step_us: FloatArray
    estimate_us: FloatArray
    error_px: float


def free_run(
    tracker: MarkerTracker, windows: Sequence[EventPacket], stream: BenchStream, every: int = 1
) -> FreeRun:
    """Time each step; ``every`` estimates only at every n-th window (for slow peers).

    Args:
        tracker: Freshly made.
        windows: The stream in windows.
        stream: For the truth.
        every: 1 estimates at each window.
    """
    warm_up = int(WARM_UP_SHARE * len(windows))
    step, estimate, times, found = [], [], [], []
    for number, window in enumerate(windows):
        begin = time.perf_counter()
        tracker.absorb(window)
        middle = time.perf_counter()
        if number % every:
            continue
        frame = tracker.estimate(window.t_end_us)
        end = time.perf_counter()
        if number >= warm_up:
            step.append(end - begin)
            estimate.append(end - middle)
            times.append(window.t_end_us)
            found.append(frame.detected_px)
    error = np.linalg.norm(np.array(found) - stream.truth.at(np.array(times)), axis=2)
    return FreeRun(US_PER_S * np.array(step), US_PER_S * np.array(estimate), float(error.mean()))


def paced_run(
    build: Callable[[Calibration], MarkerTracker],
    calibration: Calibration,
    windows: Sequence[EventPacket],
    duration_s: float,
) -> FloatArray:
    """Return the latency of each step, us, from when its window is complete to its output.

    The windows are repeated without end; they hold whole turns of the motion. It waits in a busy
    loop: a process that sleeps wakes late, on a virtual machine by up to 1 ms (measured: 0.2 to
    1.2 % of the steps missed, 0.01 to 0.04 % without sleep), which would measure the machine.

    Args:
        build: Makes the tracker.
        calibration: Of the sensor.
        windows: One per millisecond.
        duration_s: How long.
    """
    tracker = build(calibration)
    span_us = windows[-1].t_end_us - windows[0].t_start_us
    for window in windows:
        tracker.absorb(window)
        tracker.estimate(window.t_end_us)
    steps = int(duration_s * US_PER_S / PACE_US)
    latency_us = np.empty(steps)
    start = time.perf_counter()
    for number in range(steps):
        turn, index = divmod(number, len(windows))
        shift_us, window = (turn + 1) * span_us, windows[index]
        window = replace(
            window,
            t=window.t + shift_us,
            t_start_us=window.t_start_us + shift_us,
            t_end_us=window.t_end_us + shift_us,
        )
        due = start + number * PACE_US / US_PER_S
        while time.perf_counter() < due:
            pass
        tracker.absorb(window)
        tracker.estimate(window.t_end_us)
        latency_us[number] = US_PER_S * (time.perf_counter() - due)
    return latency_us
