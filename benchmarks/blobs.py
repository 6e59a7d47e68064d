"""Map to marker centres: this package beside a tuned OpenCV, on the same maps in the same run.

Only ratios within one run count; the methods take turns on every map, so that a busy machine slows
all of them. One thread each. Needs the extra ``[bench]``.

    python benchmarks/blobs.py FOLDER [recording]

FOLDER holds ``mix.raw`` and ``mix.truth.npz`` (or those of another recording).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from spikingtac.denoise.classical import Box7, Median3
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.markers.published.associate import UNMATCHED, associate, associate_tree
from spikingtac.markers.published.blob_tracker import BlobTrackerConfig, smallest_spacing_px
from spikingtac.markers.published.blobs import BlobConfig, BlobDetector
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.paint import paint_binary_discs

PERIOD_US = 2_857  # the paper's 350 Hz
MAPS_BETWEEN_SAMPLES = 8
WARM_UP_MAPS = 5
WHITE = 255
Detector = Callable[[np.ndarray], np.ndarray]


def opencv_detector(disc_area_px: float) -> Detector:
    """OpenCV as its best user would set it: 7x7 blur, one threshold, area the only filter."""
    cv2.setNumThreads(1)
    share = BlobTrackerConfig()
    params = cv2.SimpleBlobDetector_Params()
    params.minThreshold, params.maxThreshold, params.thresholdStep = 127, 128, 10
    params.minRepeatability = 1
    params.filterByColor = params.filterByCircularity = False
    params.filterByConvexity = params.filterByInertia = False
    params.filterByArea = True
    params.minArea = share.min_area_share * disc_area_px
    params.maxArea = share.max_area_share * disc_area_px
    detector = cv2.SimpleBlobDetector_create(params)

    def detect(state_map: np.ndarray) -> np.ndarray:
        blurred = cv2.blur((state_map * WHITE).astype(np.uint8), (7, 7))
        points = detector.detect(blurred)
        return np.array([point.pt for point in points]).reshape(-1, 2)

    return detect


def own_detector(disc_area_px: float, size: tuple[int, int], denoiser: Median3 | Box7) -> Detector:
    share = BlobTrackerConfig()
    detector = BlobDetector(
        size,
        BlobConfig(
            min_area_px=share.min_area_share * disc_area_px,
            max_area_px=share.max_area_share * disc_area_px,
        ),
    )
    return lambda state_map: detector.detect(denoiser.clean(state_map)).center_px


def main(folder: Path, name: str) -> None:
    source = open_events(folder / f"{name}.raw")
    truth = dict(np.load(folder / f"{name}.truth.npz"))  # read once, not at every access
    reference = truth["reference_px"].astype(np.float64)
    radius = truth["radius_px"].astype(np.float64)
    disc_area_px = float(np.pi * np.mean(radius**2))
    own = {
        "median3 + blobs": own_detector(disc_area_px, source.size, Median3()),
        "box7 + blobs": own_detector(disc_area_px, source.size, Box7()),
    }
    detectors = {"opencv tuned": opencv_detector(disc_area_px), **own}
    state_map = BinaryStateMap(source.size, paint_binary_discs(source.size, reference, radius))
    times_us: dict[str, list[float]] = {method: [] for method in [*detectors, "pairs", "trees"]}
    errors_px: dict[str, list[float]] = {method: [] for method in detectors}
    previous = {method: reference.copy() for method in detectors}
    proximity_px = BlobTrackerConfig().proximity_share * smallest_spacing_px(reference)
    for index, window in enumerate(windows(source, PERIOD_US)):
        state_map.absorb(window)
        at = min(
            np.searchsorted(truth["marker_t_us"], window.t_end_us), len(truth["marker_px"]) - 1
        )
        sampled = index % MAPS_BETWEEN_SAMPLES == 0 and index >= WARM_UP_MAPS
        for method, detect in detectors.items():
            start = perf_counter()
            centers = detect(state_map.values)
            times_us[method].append(1e6 * (perf_counter() - start))
            match, pairs_us = timed(associate, previous[method], centers, proximity_px)
            if sampled and method == "median3 + blobs":
                times_us["pairs"].append(pairs_us)
                times_us["trees"].append(
                    timed(associate_tree, previous[method], centers, proximity_px)[1]
                )
            found = match != UNMATCHED
            previous[method][found] = centers[match[found]]
            offset = previous[method] - truth["marker_px"][at]
            errors_px[method].append(float(np.hypot(*offset.T).mean()))
    report(times_us, errors_px)


def timed(matcher: Callable[..., np.ndarray], *given: object) -> tuple[np.ndarray, float]:
    start = perf_counter()
    match = matcher(*given)
    return match, 1e6 * (perf_counter() - start)


def report(times_us: dict[str, list[float]], errors_px: dict[str, list[float]]) -> None:
    peer_us = float(np.median(times_us["opencv tuned"][WARM_UP_MAPS:]))
    print(f"{'method':<18}{'p50 us':>9}{'p99 us':>9}{'times faster':>14}{'error px':>10}")
    for method, samples in times_us.items():
        p50_us, p99_us = np.percentile(samples[WARM_UP_MAPS:], (50, 99))
        if method in errors_px:
            rest = f"{peer_us / p50_us:>14.1f}{np.mean(errors_px[method]):>10.3f}"
        else:
            rest = "   (association of 64 markers)"
        print(f"{method:<18}{p50_us:>9.0f}{p99_us:>9.0f}{rest}")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python benchmarks/blobs.py FOLDER [recording]")
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "mix")
