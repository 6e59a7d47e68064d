"""eKalibr's circle detector as a marker tracker: two arcs give a centre without bias.

Source: S. Chen et al., "eKalibr: dynamic intrinsic calibration for event cameras from first
principles of events", IEEE RA-L 10, 2025 (arXiv:2501.05688), and its public source code.

Re-derived: surface of active events (20 ms) -> normal flow from planes in 3x3 pixels -> clusters of
each polarity (dilated, at least 10 px) -> pairs of opposite polarity whose flows agree within 30
degrees -> a circle whose centre and radius move linearly in time, fitted to the raw events of the
pair and accepted below 2 px. A detection is assigned to the nearest marker. A marker without a
detection keeps its place.

Differences: the original looks for the dots of a moving calibration board and interpolates. Here
the polarity of the markers is known, so that the leading arc need not be found from the spread of
its flow. The outliers of a plane are removed after each of two fits instead of by random sampling,
so that equal events give equal results. A pair must lie within a marker's size, and the radius of
the circle must be near the calibrated ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spikingtac import Calibration
from spikingtac.events import HotPixelFilter
from spikingtac.markers import UNMATCHED, associate, smallest_spacing_px
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

RATE_HZ = 100.0  # Estimates per second, Hz (two per window).
ROUNDS = 2  # Number of fits of each plane (original).
TOLERANCE_US = 2_000.0  # Largest residual of a plane's inlier, us (original).
INLIER_FRACTION = 0.6  # Smallest fraction of inliers of a plane (original).
MIN_CLUSTER_PX = 10  # Smallest cluster, px (original).
ANGLE_DEG = 30.0  # Largest angle between the flows of a pair, degrees (original).
RESIDUAL_PX = 2.0  # Largest mean residual of a circle, px (original).
ITERATIONS = 6  # Iterations of the circle's fit.
NEVER = -(2**62)  # Time of a pixel without any event, us.

# Smallest number of active pixels, of nine, for a plane: one more than its parameters.
PLANE_POINTS = 4

# Columns and rows of a block of 3x3 pixels from its middle, px.
PLACES = np.array([(column, row) for row in (-1, 0, 1) for column in (-1, 0, 1)], np.float64)

# Damping of a circle's centre, velocity, radius and growth per event, for a stable fit.
DAMPING = np.array([1e-6, 1e-6, 1e-2, 1e-2, 1e-2, 1e-1])

# Association threshold as a fraction of the smallest spacing of the markers.
PROXIMITY_FRACTION = 0.5


class EkalibrTracker:
    """Detects moving circles anew at every estimate."""

    def __init__(
        self,
        calibration: Calibration,
        *,
        window_us: int = 20_000,
        dilate_px: int = 5,
        radius_tolerance: float = 0.35,
    ) -> None:
        """Start at the calibrated rest positions.

        Args:
            calibration: Rest positions, radii and polarity of the markers.
            window_us: Time for which an event is active, us (original: 20 ms).
            dilate_px: Largest distance of pixels of one cluster, px (original: 3; tuned).
            radius_tolerance: Largest relative deviation of the radius from the calibrated one.
        """
        self._calibration, self._window_us = calibration, window_us
        self._dilate_px, self._radius_tolerance = dilate_px, radius_tolerance
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        self._radius_px = float(calibration.radius_px.mean())
        spacing_px = smallest_spacing_px(calibration.reference_px)
        self._proximity_px = PROXIMITY_FRACTION * spacing_px
        width, height = calibration.size
        self._last_us = np.empty((2, height, width), np.int64)
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        """Take in all events of the next packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size, or leaves it.
        """
        packet.require_map(self._last_us.shape[1:])
        packet = self._hot.kept(packet)
        if not len(packet):
            return
        bright = packet.p != (self._calibration.polarity == "dark")
        # Of a pixel's events the last one is kept.
        self._last_us[bright.astype(np.int64), packet.y, packet.x] = packet.t
        self._recent.append(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``. A marker without a circle keeps its last place."""
        since_us = t_us - self._window_us
        self._recent = [packet for packet in self._recent if packet.t[-1] >= since_us]
        center_px = self._circles(t_us, since_us)
        match = associate(self._detected_px, center_px, self._proximity_px)
        coasted = match == UNMATCHED
        self._detected_px[~coasted] = center_px[match[~coasted]]
        given, moved = self._detected_px.copy(), self._detected_px - self._calibration.reference_px
        return MarkerFrame(t_us, given, given, moved, coasted, np.where(coasted, 0.0, 1.0))

    def reset(self) -> None:
        """Return to the calibrated rest positions."""
        self._last_us[:] = NEVER
        self._recent: list[EventPacket] = []
        self._detected_px: FloatArray = self._calibration.reference_px.astype(np.float64)

    def _circles(self, t_us: int, since_us: int) -> FloatArray:
        """Return the centres ``(n, 2)`` of the circles at ``t_us``, px."""
        labels, arcs = [], []
        for last_us in self._last_us:
            found = find_arcs(normal_flow(last_us, since_us), last_us >= since_us, self._dilate_px)
            labels.append(found[0])
            arcs.append(found[1])
        pairs = pair_arcs(arcs[0], arcs[1], 3.0 * self._radius_px)
        if not len(pairs):
            return np.empty((0, 2))
        points, groups, first = self._grouped(labels, t_us)
        trailing, leading = arcs[0][pairs[:, 0]], arcs[1][pairs[:, 1]]
        centers = []
        for behind, before in zip(trailing, leading, strict=True):
            numbers = int(behind[0]), int(before[0]) + int(labels[0].max()) + 1
            at = np.searchsorted(groups, numbers)
            own = [points[first[k] : first[k + 1]] for k in at]
            center_px = self._circle(np.concatenate(own), 0.5 * (behind + before)[1:])
            if center_px is not None:
                centers.append(center_px)
        return np.array(centers).reshape(-1, 2)

    def _grouped(
        self, labels: list[NDArray[np.int32]], t_us: int
    ) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.intp]]:
        """Return the recent events ``(n, 3)`` sorted by arc, the arcs, and the first of each."""
        x, y, p, t = (
            np.concatenate([getattr(packet, name) for packet in self._recent]) for name in "xypt"
        )
        recent = t >= t_us - self._window_us
        x, y, p, t = x[recent], y[recent], p[recent], t[recent]
        bright = p != (self._calibration.polarity == "dark")
        group = np.where(bright, labels[1][y, x] + labels[0].max() + 1, labels[0][y, x])
        order = np.argsort(group, kind="stable")
        points = np.column_stack([x, y, (t - t_us) / self._window_us])[order]
        groups, first = np.unique(group[order], return_index=True)
        return points.astype(np.float64), groups, np.append(first, len(points))

    def _circle(self, points: FloatArray, arcs: FloatArray) -> FloatArray | None:
        """Return the centre ``(2,)`` of a circle through events; None where none fits.

        Args:
            points: ``(n, 3)`` events: x px, y px, time from the estimate in windows.
            arcs: ``(4,)`` mean centre, px, and mean flow, px/us, of the two arcs.
        """
        speed = arcs[2:] * self._window_us
        # Half of the window ago the marker was in the middle of its arcs.
        start = np.array([*(arcs[:2] + 0.5 * speed), *speed, self._radius_px, 0.0])
        fit, residual_px = moving_circle(points, start, ITERATIONS)
        deviation = abs(fit[4] - self._radius_px) / self._radius_px
        fits = residual_px < RESIDUAL_PX and deviation < self._radius_tolerance
        return fit[:2] if fits else None


def normal_flow(last_us: NDArray[np.int64], since_us: int) -> FloatArray:
    """Fit a plane t = a x + b y + c to each active pixel's 3x3; return its normal flow, px/us.

    The flow is the gradient divided by its square; it is 0 where no plane fits. Outliers are
    removed after each fit.

    Args:
        last_us: ``(height, width)`` last event times of one polarity, us.
        since_us: Pixels with an older last event are not active, us.

    Returns:
        ``(2, height, width)`` flow along x and y.
    """
    flow = np.zeros((2, *last_us.shape))
    row, column = np.nonzero(last_us[1:-1, 1:-1] >= since_us)
    around = np.lib.stride_tricks.sliding_window_view(last_us, (3, 3))[row, column].reshape(-1, 9)
    active = around >= since_us
    later_us = np.where(active, around - around[:, 4:5], 0).astype(np.float64)
    used, fits = active, np.ones(len(row), np.bool_)
    slope = np.zeros((len(row), 2))
    for _ in range(ROUNDS):
        fits &= used.sum(axis=1) >= PLANE_POINTS
        slope, level = _planes(later_us, used.astype(np.float64))
        off_us = later_us - slope @ PLACES.T - level[:, None]
        used = active & (np.abs(off_us) <= TOLERANCE_US)
    least = np.maximum(PLANE_POINTS, INLIER_FRACTION * active.sum(axis=1))
    square = (slope**2).sum(axis=1)
    fits &= (used.sum(axis=1) >= least) & (square > 0.0)
    flow[:, row[fits] + 1, column[fits] + 1] = slope[fits].T / square[fits]
    return flow


def _planes(later_us: FloatArray, used: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slopes ``(n, 2)`` and levels ``(n,)`` of planes through the used of nine pixels."""
    count = np.maximum(used.sum(axis=1), 1.0)[:, None]
    mean, level = used @ PLACES / count, (used * later_us).sum(axis=1) / count[:, 0]
    xx, yy = (used @ PLACES**2 - count * mean**2).T
    xy = used @ PLACES.prod(axis=1) - count[:, 0] * mean.prod(axis=1)
    xt, yt = ((used * later_us) @ PLACES - count * mean * level[:, None]).T
    determinant = xx * yy - xy**2
    spans = determinant >= 1e-9  # Otherwise the points lie on a line.
    slope = np.column_stack([xt * yy - yt * xy, yt * xx - xt * xy])
    slope = np.where(spans[:, None], slope / np.where(spans, determinant, 1.0)[:, None], 0.0)
    return slope, level - (slope * mean).sum(axis=1)


def moving_circle(
    points: FloatArray, start: FloatArray, iterations: int
) -> tuple[FloatArray, float]:
    """Fit |e - c - v s| = r + q s to events by damped Gauss-Newton iterations.

    Args:
        points: ``(n, 3)`` events: x px, y px, and s, the time relative to the estimate, scaled to
            -1 to 0 over the window.
        start: ``(6,)`` first guess: centre x, y, velocity x, y (px per window), radius, growth of
            the radius.
        iterations: Number of iterations.

    Returns:
        The six parameters, and the mean absolute residual, px.
    """
    fit, s, error = start.copy(), points[:, 2], np.zeros(0)
    rows = np.ones((len(points), 6))
    rows[:, 5] = s
    damping = np.diag(DAMPING * len(points) + 1e-9)
    for step in range(iterations + 1):
        away = points[:, :2] - fit[:2] - s[:, None] * fit[2:4]
        distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
        error = distance - fit[4] - fit[5] * s
        if step < iterations:
            rows[:, :2] = away / distance[:, None]
            rows[:, 2:4] = rows[:, :2] * s[:, None]
            fit += np.linalg.solve(rows.T @ rows + damping, rows.T @ error)
    return fit, float(np.abs(error).mean())


def find_arcs(
    flow: FloatArray, active: NDArray[np.bool_], dilate_px: int
) -> tuple[NDArray[np.int32], FloatArray]:
    """Cluster the active pixels of one polarity that have a flow.

    Args:
        flow: ``(2, height, width)`` normal flow, px/us; 0 where there is none.
        active: ``(height, width)`` active pixels.
        dilate_px: Largest distance of pixels of one cluster, px.

    Returns:
        ``(height, width)`` label image (0 is none), and the arcs ``(k, 5)``: label, mean place x,
        y, px, mean flow x, y, px/us.
    """
    moving = active & flow.any(axis=0)
    grown = ndimage.maximum_filter(moving, 2 * (dilate_px // 2) + 1, mode="constant")
    label = np.zeros(grown.shape, np.int32)
    ndimage.label(grown, np.ones((3, 3)), output=label)
    count = int(label.max())
    label[~active] = 0
    row, column = np.nonzero(moving)
    number = label[row, column]
    size = np.bincount(number, minlength=count + 1)
    values = (number, column, row, *flow[:, row, column])
    arcs = np.column_stack(
        [np.bincount(number, one, count + 1) / np.maximum(size, 1) for one in values]
    )
    return label, arcs[1:][size[1:] >= MIN_CLUSTER_PX]


def pair_arcs(trailing: FloatArray, leading: FloatArray, reach_px: float) -> NDArray[np.int64]:
    """Return which arcs ``(n, 2)`` have the same motion, one behind the other.

    Each arc belongs to one pair at most.

    Args:
        trailing: Arcs that become darker, of :func:`find_arcs`: behind a bright marker.
        leading: Arcs that become brighter: in front of it.
        reach_px: Largest distance between the two arcs, px.
    """
    offset = leading[None, :, 1:3] - trailing[:, None, 1:3]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    behind, before = _unit(trailing[:, 3:]), _unit(leading[:, 3:])
    min_cosine = np.cos(np.radians(ANGLE_DEG))
    agree = behind @ before.T >= min_cosine
    direction = _unit(behind[:, None] + before[None])
    along = (direction * offset).sum(axis=2) >= min_cosine * distance
    cost = np.where(agree & along & (distance <= reach_px), distance, np.inf)
    pairs = []
    while np.isfinite(cost).any():
        i, j = np.unravel_index(int(cost.argmin()), cost.shape)
        pairs.append((i, j))
        cost[i], cost[:, j] = np.inf, np.inf
    return np.array(pairs, np.int64).reshape(-1, 2)


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, np.finfo(np.float64).tiny)
