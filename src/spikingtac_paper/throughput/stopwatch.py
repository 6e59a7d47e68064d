"""Time steps of a tracker, free running or paced."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac import Calibration, MarkerTracker
from spikingtac.errors import DeviceError
from spikingtac.types import EventPacket
from spikingtac_paper.throughput.stream import BenchStream

US_PER_S = 1e6
PACE_US = 1_000  # Period of the paced run: 1 kHz.

# Fraction of the steps that runs first and is not timed: kernels compile, caches fill.
WARM_UP_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Steps of a tracker that never waits.

    Attributes:
        step_us: ``(n,)`` absorb and estimate together, us.
        estimate_us: ``(n,)`` the estimate alone: map to centres, us.
        error_px: Mean error against the truth, px.
    """

    step_us: NDArray[np.float64]
    estimate_us: NDArray[np.float64]
    error_px: float


def windows_of(stream: BenchStream, period_us: int) -> list[EventPacket]:
    """Return the stream in whole windows."""
    events = stream.events
    edges = np.arange(events.t_start_us, events.t_end_us + 1, period_us)
    at = np.searchsorted(events.t, edges)
    return [
        events.part(int(at[k]), int(at[k + 1]), int(edges[k]), int(edges[k + 1]))
        for k in range(len(edges) - 1)
    ]


def free_run(
    tracker: MarkerTracker, windows: Sequence[EventPacket], stream: BenchStream, every: int = 1
) -> FreeRun:
    """Time each step; ``every`` estimates only at every n-th window (for slow peers).

    Args:
        tracker: Freshly made.
        windows: From :func:`windows_of`.
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
) -> NDArray[np.float64]:
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
        window = _later(windows[index], (turn + 1) * span_us)
        due = start + number * PACE_US / US_PER_S
        while time.perf_counter() < due:
            pass
        tracker.absorb(window)
        tracker.estimate(window.t_end_us)
        latency_us[number] = US_PER_S * (time.perf_counter() - due)
    return latency_us


def in_own_process(function: Callable[..., None], *arguments: object) -> NDArray[np.float64]:
    """Run a function in a fresh process and return the array that it puts into a queue.

    Args:
        function: Importable; called with a queue and the arguments.
        arguments: What it needs.

    Raises:
        DeviceError: The process died.
    """
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=function, args=(queue, *arguments))
    process.start()
    while process.is_alive() and queue.empty():
        time.sleep(0.05)
    if queue.empty() and process.exitcode:
        raise DeviceError(f"the paced run's process ended with code {process.exitcode}")
    values = queue.get()
    process.join()
    return values


def _later(window: EventPacket, shift_us: int) -> EventPacket:
    return replace(
        window,
        t=window.t + shift_us,
        t_start_us=window.t_start_us + shift_us,
        t_end_us=window.t_end_us + shift_us,
    )
