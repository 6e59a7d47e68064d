"""Peers of the throughput bench: map to centres, each as its best user would set it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac import Calibration
from spikingtac.config import load_config
from spikingtac.errors import import_extra
from spikingtac.events import BackgroundActivityFilter
from spikingtac.markers import (
    PROXIMITY_SHARE,
    UNMATCHED,
    associate,
    blob_areas_px,
    painted_binary_map,
    smallest_spacing_px,
)
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

WHITE = 255
BLUR_PX = 7  # Side of the box that cleans the map: the best of those tried on recordings.

FLOW_WINDOW_PX = 21  # Side of Lucas-Kanade's window: a marker and its edge.

FIELDS_PER_MARKER = 1.5  # trackpy's separation, in marker diameters.

Locate = Callable[[NDArray[np.uint8]], FloatArray]


class PeerTracker:
    """A peer behind the tracker's protocol: the same binary map, its own way to the centres.

    The map lies behind the filter of lone events that the preset ``paper`` has: without one, leak
    paints it white, and no detector finds anything.
    """

    def __init__(self, locate: Locate, calibration: Calibration, *, tracks: bool = False) -> None:
        """Begin at rest.

        Args:
            locate: From a map of 0 and 255 to centres ``(n, 2)``.
            calibration: Where the markers rest.
            tracks: True where ``locate`` keeps the identities itself.
        """
        self._locate, self._calibration, self._tracks = locate, calibration, tracks
        self._map = painted_binary_map(calibration)
        support_us = load_config("paper").tracking.blobs.support_us
        self._filter = BackgroundActivityFilter(calibration.size, support_us)
        spacing_px = smallest_spacing_px(calibration.reference_px)
        self._proximity_px = PROXIMITY_SHARE * spacing_px
        self._detected_px = calibration.reference_px.copy()

    def absorb(self, packet: EventPacket) -> None:
        """Paint the events that are supported."""
        self._map.absorb(self._filter(packet))

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the centres, each under its marker's identity."""
        found = self._locate((self._map.values * WHITE).astype(np.uint8))
        if self._tracks:
            self._detected_px, coasted = found, np.zeros(len(found), np.bool_)
        else:
            match = associate(self._detected_px, found, self._proximity_px)
            coasted = match == UNMATCHED
            self._detected_px[~coasted] = found[match[~coasted]]
        given = self._detected_px.copy()
        moved = given - self._calibration.reference_px
        return MarkerFrame(t_us, given, given, moved, coasted, np.where(coasted, 0.0, 1.0))

    def reset(self) -> None:
        """Not needed by the bench."""
        raise NotImplementedError("a peer is made anew for each run")


def opencv_tuned(calibration: Calibration) -> PeerTracker:
    """Return OpenCV: 7x7 blur, SimpleBlob with one threshold, area the only filter, k-d tree."""
    cv2 = _opencv()
    params = cv2.SimpleBlobDetector_Params()
    params.minThreshold, params.maxThreshold, params.thresholdStep = 127, 128, 10
    params.minRepeatability = 1
    params.filterByColor = params.filterByCircularity = False
    params.filterByConvexity = params.filterByInertia = False
    params.filterByArea = True
    params.minArea, params.maxArea = blob_areas_px(calibration.radius_px)
    detector = cv2.SimpleBlobDetector_create(params)

    def locate(image: NDArray[np.uint8]) -> FloatArray:
        points = detector.detect(cv2.blur(image, (BLUR_PX, BLUR_PX)))
        return np.array([point.pt for point in points], np.float64).reshape(-1, 2)

    return PeerTracker(locate, calibration)


def trackpy_locate(calibration: Calibration) -> PeerTracker:
    """Return trackpy's ``locate`` on the blurred map, identities by the k-d tree."""
    cv2 = _opencv()
    trackpy = import_extra("trackpy", "a comparison with peers", "bench")
    trackpy.quiet()
    radius_px = float(calibration.radius_px.mean())
    diameter = 2 * round(radius_px) + 1

    def locate(image: NDArray[np.uint8]) -> FloatArray:
        blurred = cv2.blur(image, (BLUR_PX, BLUR_PX))
        found = trackpy.locate(
            blurred,
            diameter,
            separation=FIELDS_PER_MARKER * diameter,
            preprocess=False,
            characterize=False,
            engine="numba",
        )
        return np.column_stack([found["x"], found["y"]]).astype(np.float64)

    return PeerTracker(locate, calibration)


def lucas_kanade(calibration: Calibration) -> PeerTracker:
    """Return OpenCV's pyramidal Lucas-Kanade flow from map to map."""
    cv2 = _opencv()
    blurred = cv2.blur((painted_binary_map(calibration).values * WHITE).astype(np.uint8), (5, 5))
    state = [blurred, calibration.reference_px.astype(np.float32).reshape(-1, 1, 2)]

    def locate(image: NDArray[np.uint8]) -> FloatArray:
        now = cv2.blur(image, (5, 5))
        points, found, _ = cv2.calcOpticalFlowPyrLK(
            state[0], now, state[1], None, winSize=(FLOW_WINDOW_PX, FLOW_WINDOW_PX), maxLevel=1
        )
        state[0], state[1] = now, np.where(found[:, :, None] > 0, points, state[1])
        return state[1].reshape(-1, 2).astype(np.float64)

    return PeerTracker(locate, calibration, tracks=True)


# Name -> how to build it.
PEERS: dict[str, Callable[[Calibration], PeerTracker]] = {
    "opencv_tuned": opencv_tuned,
    "trackpy": trackpy_locate,
    "lucas_kanade": lucas_kanade,
}


def _opencv() -> Any:
    cv2 = import_extra("cv2", "a comparison with peers", "bench")
    cv2.setNumThreads(1)
    return cv2
