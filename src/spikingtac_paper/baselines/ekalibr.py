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

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.markers.published.associate import UNMATCHED, associate
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac_paper.baselines.arc_kernels import (
    NEVER,
    moving_circle_kernel,
    normal_flow_kernel,
    update_active_kernel,
)
from spikingtac_paper.baselines.arcs import Arc, find_arcs, pair_arcs
from spikingtac_paper.baselines.recent import RecentEvents


@dataclass(frozen=True, kw_only=True, slots=True)
class EkalibrConfig:
    """Parameters of the original, and those that tracking adds.

    Attributes:
        rate_hz: Estimates per second, Hz (ours: two per window).
        window_us: Time for which an event is active, us (original: 20 ms).
        rounds: Number of fits of each plane (original: 2).
        tolerance_us: Largest residual of a plane's inlier, us (original: 2 ms).
        inlier_fraction: Smallest fraction of inliers (original: 0.6).
        dilate_px: Largest distance of pixels of one cluster, px (original: 3; tuned).
        min_cluster_px: Smallest cluster, px (original: 10).
        angle_deg: Largest angle between the flows of a pair, degrees (original: 30).
        residual_px: Largest mean residual of a circle, px (original: 2).
        radius_tolerance: Largest relative deviation of the radius from the calibrated one.
        iterations: Iterations of the circle's fit.
        proximity_fraction: Association threshold as a fraction of the smallest spacing.
    """

    rate_hz: float = 100.0
    window_us: int = 20_000
    rounds: int = 2
    tolerance_us: float = 2_000.0
    inlier_fraction: float = field(default=0.6, metadata={"former_names": ("inlier_share",)})
    dilate_px: int = 5
    min_cluster_px: int = field(default=10, metadata={"former_names": ("fewest_px",)})
    angle_deg: float = 30.0
    residual_px: float = 2.0
    radius_tolerance: float = 0.35
    iterations: int = 6
    proximity_fraction: float = field(default=0.5, metadata={"former_names": ("proximity_share",)})

    def __post_init__(self) -> None:
        for name in ("rate_hz", "window_us", "rounds", "dilate_px", "min_cluster_px", "iterations"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} is {getattr(self, name)}, it must be positive")


class EkalibrTracker:
    """Detects moving circles anew at every estimate."""

    def __init__(self, config: EkalibrConfig, calibration: Calibration) -> None:
        """Start at the calibrated rest positions.

        Args:
            config: Parameters.
            calibration: Rest positions, radii and polarity of the markers.
        """
        self._config, self._calibration = config, calibration
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        self._radius_px = float(calibration.radius_px.mean())
        spacing_px = smallest_spacing_px(calibration.reference_px)
        self._proximity_px = config.proximity_fraction * spacing_px
        width, height = calibration.size
        self._last_us = np.empty((2, height, width), np.int64)
        self._flow = np.empty((2, 2, height, width))
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        """Take in all events of the next packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size, or leaves it.
        """
        packet.require_map(self._last_us.shape[1:])
        packet = self._hot.kept(packet)
        bright = packet.p != (self._calibration.polarity == "dark")
        polarity = bright.astype(np.int64)
        update_active_kernel(packet.x, packet.y, polarity, packet.t, self._last_us)
        self._recent.add(packet, polarity)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``. A marker without a circle keeps its last place."""
        since_us = t_us - self._config.window_us
        self._recent.drop_before(since_us)
        center_px = self._circles(t_us, since_us)
        match = associate(self._detected_px, center_px, self._proximity_px)
        coasted = match == UNMATCHED
        self._detected_px[~coasted] = center_px[match[~coasted]]
        reference_px = self._calibration.reference_px
        return MarkerFrame(
            t_us=t_us,
            detected_px=self._detected_px.copy(),
            position_px=self._detected_px.copy(),
            displacement_px=self._detected_px - reference_px,
            coasted=coasted,
            confidence=np.where(coasted, 0.0, 1.0),
        )

    def reset(self) -> None:
        """Return to the calibrated rest positions."""
        self._last_us[:] = NEVER
        self._recent = RecentEvents()
        self._detected_px: NDArray[np.float64] = self._calibration.reference_px.astype(np.float64)

    def _circles(self, t_us: int, since_us: int) -> NDArray[np.float64]:
        config = self._config
        arcs: list[list[Arc]] = []
        labels: list[NDArray[np.int32]] = []
        for polarity in (0, 1):
            normal_flow_kernel(
                self._last_us[polarity],
                since_us,
                config.rounds,
                config.tolerance_us,
                config.inlier_fraction,
                self._flow[polarity],
            )
            active = self._last_us[polarity] >= since_us
            label, found = find_arcs(
                active, self._flow[polarity], config.dilate_px, config.min_cluster_px
            )
            labels.append(label)
            arcs.append(found)
        pairs = pair_arcs(arcs[0], arcs[1], config.angle_deg, 3.0 * self._radius_px)
        if not pairs:
            return np.empty((0, 2))
        points, first = self._grouped(labels, t_us)
        offset = int(labels[0].max()) + 1
        centers = []
        for trailing, leading in pairs:
            dark = points[first[trailing.label] : first[trailing.label + 1]]
            bright = points[first[offset + leading.label] : first[offset + leading.label + 1]]
            center_px = self._circle(np.concatenate([dark, bright]), trailing, leading)
            if center_px is not None:
                centers.append(center_px)
        return np.array(centers).reshape(-1, 2)

    def _grouped(
        self, labels: list[NDArray[np.int32]], t_us: int
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the recent events ``(n, 3)`` sorted by arc, and the first index of each arc."""
        x, y, polarity, t = self._recent.columns()
        offset = int(labels[0].max()) + 1
        group = np.where(polarity > 0, offset + labels[1][y, x], labels[0][y, x])
        group = group.astype(np.int16)  # so few that numpy sorts by digits
        order = np.argsort(group, kind="stable")
        points = np.column_stack([x, y, (t - t_us) / self._config.window_us])[order]
        arcs = np.arange(offset + int(labels[1].max()) + 2)
        return points.astype(np.float64), np.searchsorted(group[order], arcs)

    def _circle(
        self, points: NDArray[np.float64], trailing: Arc, leading: Arc
    ) -> NDArray[np.float64] | None:
        middle_px = 0.5 * (trailing.center_px + leading.center_px)
        speed = 0.5 * (trailing.flow_px_us + leading.flow_px_us) * self._config.window_us
        # Half of the window ago the marker was in the middle of its arcs.
        start = np.array([*(middle_px + 0.5 * speed), *speed, self._radius_px, 0.0])
        fit, residual_px = moving_circle_kernel(points, start, self._config.iterations)
        deviation = abs(fit[4] - self._radius_px) / self._radius_px
        fits = residual_px < self._config.residual_px
        if not (fits and deviation < self._config.radius_tolerance):
            return None
        return fit[:2]
