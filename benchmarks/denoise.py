"""Time per map of every denoiser, and per estimate of the whole paper preset, in one run.

Only ratios within one run count; the denoisers take turns on every map, so that a busy machine
slows all of them. One thread each.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python benchmarks/denoise.py [--published]

``--published`` adds the network in the size of EV-FlowNet (random weights; needs the extra
``[train]`` and about a gigabyte of memory).
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.denoise.denoiser import Denoiser
from spikingtac.denoise.registry import make_denoiser
from spikingtac.events.windows import windows
from spikingtac.markers.registry import make_tracker
from spikingtac_paper.denoise.recordings import TrueRecording, render
from spikingtac_paper.denoise.scoring import state_maps
from spikingtac_paper.training.degrade import with_background

SCENE, SEED, DURATION_S = "finger-slides", 1001, 3.0
NOISE_HZ = 0.2
MAP_EVERY_US = 5_000
WARM_UP = 20
STEP_US = 1_000  # the paper preset is asked for 1,000 estimates a second of data time
PUBLISHED_MAPS = 5
NAMES = ("none", "median3", "box7", "network", "network-int8")


def line(name: str, times_s: list[float]) -> str:
    p50_us, p99_us = 1e6 * np.percentile(times_s[WARM_UP:], (50, 99))
    rate_hz = len(times_s[WARM_UP:]) / sum(times_s[WARM_UP:])
    return f"{name:<24}{p50_us:>10.0f}{p99_us:>10.0f}{rate_hz:>12.0f}"


def timed(function: Callable[..., object], *given: object) -> float:
    start = perf_counter()
    function(*given)
    return perf_counter() - start


def time_maps(recording: TrueRecording, denoisers: dict[str, Denoiser]) -> dict[str, list[float]]:
    events = with_background(recording.clean.events, NOISE_HZ, np.random.default_rng(0))
    at_us = np.arange(500_000, events.t_end_us, MAP_EVERY_US)
    times: dict[str, list[float]] = {name: [] for name in denoisers}
    for state_map in state_maps(recording.clean, events, "binary", at_us):
        for name, denoiser in denoisers.items():
            times[name].append(timed(denoiser.clean, state_map))
    return times


def time_preset(recording: TrueRecording) -> dict[str, list[float]]:
    clean = recording.clean
    events = with_background(clean.events, NOISE_HZ, np.random.default_rng(0))
    calibration = Calibration(
        reference_px=clean.reference_px, radius_px=clean.radius_px, grid=(8, 8), size=events.size
    )
    config = load_config("paper").tracking
    trackers = {name: make_tracker(replace(config, denoiser=name), calibration) for name in NAMES}
    times: dict[str, list[float]] = {name: [] for name in trackers}
    for window in windows([events], STEP_US):
        for name, tracker in trackers.items():
            step = timed(tracker.absorb, window)
            times[name].append(step + timed(tracker.estimate, window.t_end_us))
    return times


def time_published(recording: TrueRecording) -> list[float]:
    import torch

    from spikingtac.denoise.infer import NetworkDenoiser
    from spikingtac_paper.training.architecture import NetworkConfig, make_network
    from spikingtac_paper.training.export import export_network
    from spikingtac_paper.training.training_state import save_weights

    config = NetworkConfig(kind="evflownet", fold=1, base=64)
    torch.manual_seed(0)
    maps = list(state_maps(recording.clean, recording.clean.events, "binary", np.array([10**6])))
    with tempfile.TemporaryDirectory() as folder:
        weights = Path(folder) / "weights.safetensors"
        save_weights(weights, make_network(config), config)
        plain, int8 = export_network(weights, folder, maps, "evflownet")
        out = []
        for path in (plain, int8):
            denoiser = NetworkDenoiser(path)
            denoiser.clean(maps[0])
            runs = [timed(denoiser.clean, maps[0]) for _ in range(PUBLISHED_MAPS)]
            out.append(float(np.median(runs)))
    return out


def main(published: bool) -> None:
    recording = render(SCENE, SEED, DURATION_S)
    head = f"{'':<24}{'p50 us':>10}{'p99 us':>10}{'per second':>12}"
    print("one map, 320x320\n" + head)
    times = time_maps(recording, {name: make_denoiser(name) for name in NAMES})
    for name in NAMES:
        print(line(name, times[name]))
    print(f"\npaper preset: absorb {STEP_US} us of events and estimate, by denoiser\n" + head)
    steps = time_preset(recording)
    for name in NAMES:
        print(line(name, steps[name]))
    if published:
        plain_s, int8_s = time_published(recording)
        print(
            f"\nEV-FlowNet, 64 channels: {1e3 * plain_s:.0f} ms, int8 {1e3 * int8_s:.0f} ms a map"
        )


if __name__ == "__main__":
    main("--published" in sys.argv[1:])
