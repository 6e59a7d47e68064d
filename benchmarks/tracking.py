"""The whole chain in one run: decode, counts and map, and the step beside a tuned OpenCV.

    python benchmarks/tracking.py FOLDER

FOLDER holds ``bootstrap.raw``, ``mix.raw`` and ``mix.truth.npz``. A step is absorb and estimate of
64 markers on the same 1 ms windows; the methods take turns on every window, so that a busy machine
slows all of them: only the ratios count. One thread each. Needs the extra ``[bench]``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from blobs import opencv_detector
from decode import print_rates, rates_mev_s

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.markers.published.associate import UNMATCHED, associate_tree
from spikingtac.markers.registry import make_tracker
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.paint import paint_binary_discs
from spikingtac.types import EventPacket

PERIOD_US = 1_000
WARM_UP_STEPS = 50
COUNT_ROUNDS = 9
DECODE_ROUNDS = 5
PEER = "opencv_tuned"
Step = Callable[[EventPacket], np.ndarray]


def preset_step(preset: str, calibration: Calibration) -> Step:
    tracker = make_tracker(load_config(preset).tracking, calibration)

    def step(window: EventPacket) -> np.ndarray:
        tracker.absorb(window)
        return tracker.estimate(window.t_end_us).detected_px

    return step


def opencv_step(calibration: Calibration) -> Step:
    """The paper's front end as OpenCV's best user would write it: map, blur, blobs, k-d tree."""
    radius_px = calibration.radius_px
    start = paint_binary_discs(calibration.size, calibration.reference_px, radius_px)
    state_map = BinaryStateMap(calibration.size, start)
    detect = opencv_detector(float(np.pi * np.mean(radius_px**2)))
    position_px = calibration.reference_px.copy()
    proximity_px = 0.5 * smallest_spacing_px(position_px)

    def step(window: EventPacket) -> np.ndarray:
        state_map.absorb(window)
        centers = detect(state_map.values)
        match = associate_tree(position_px, centers, proximity_px)
        found = match != UNMATCHED
        position_px[found] = centers[match[found]]
        return position_px.copy()

    return step


def counts_and_map_mev_s(packets: list[EventPacket]) -> float:
    """Validate, count per ms and paint, packet by packet as they come from the decoder."""
    state_map = BinaryStateMap(packets[0].size)
    times = []
    for _ in range(COUNT_ROUNDS):
        start = perf_counter()
        for packet in packets:
            state_map.absorb_counted(packet, PERIOD_US)
        times.append(perf_counter() - start)
    return sum(map(len, packets)) / float(np.median(times[1:])) / 1e6


@dataclass(frozen=True, slots=True)
class Steps:
    """Time of each step, us, and mean error, px, of one method."""

    times_us: np.ndarray
    error_px: float


def main(folder: Path) -> None:
    calibration = calibrate(open_events(folder / "bootstrap.raw"))
    packets = [packet for packet in open_events(folder / "mix.raw") if len(packet)]
    print_rates(rates_mev_s(packets, DECODE_ROUNDS))
    print(f"counts and map, validated: {counts_and_map_mev_s(packets):.0f} Mev/s")
    report(steps_in_turns(folder, calibration, packets))


def steps_in_turns(
    folder: Path, calibration: Calibration, packets: list[EventPacket]
) -> dict[str, Steps]:
    """Let the presets and tuned OpenCV take turns on every window; return each one's steps."""
    steps = {name: preset_step(name, calibration) for name in ("default", "fast", "paper")}
    steps[PEER] = opencv_step(calibration)
    times_us: dict[str, list[float]] = {name: [] for name in steps}
    found_px: dict[str, list[np.ndarray]] = {name: [] for name in steps}
    t_us = []
    for window in windows(packets, PERIOD_US):
        t_us.append(window.t_end_us)
        for name, step in steps.items():
            start = perf_counter()
            found_px[name].append(step(window))
            times_us[name].append(1e6 * (perf_counter() - start))
    truth = dict(np.load(folder / "mix.truth.npz"))
    at = np.clip(np.searchsorted(truth["marker_t_us"], t_us), 0, len(truth["marker_px"]) - 1)
    true_px = truth["marker_px"][at]
    return {
        name: Steps(
            np.array(times_us[name][WARM_UP_STEPS:]),
            float(np.linalg.norm(np.array(found) - true_px, axis=2).mean()),
        )
        for name, found in found_px.items()
    }


def report(found: dict[str, Steps]) -> None:
    """Print a line for each method."""
    peer = found[PEER]
    print(
        f"{'method':<14}{'p50 us':>8}{'p99 us':>8}{'times faster':>14}{'error px':>10}{'share':>8}"
    )
    for name, steps in found.items():
        p50_us, p99_us = np.percentile(steps.times_us, (50, 99))
        faster = float(np.median(peer.times_us)) / p50_us
        print(
            f"{name:<14}{p50_us:>8.0f}{p99_us:>8.0f}{faster:>14.1f}"
            f"{steps.error_px:>10.3f}{steps.error_px / peer.error_px:>8.2f}"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python benchmarks/tracking.py FOLDER")
    main(Path(sys.argv[1]))
