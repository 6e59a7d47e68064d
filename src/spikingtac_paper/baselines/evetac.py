"""Evetac's regularised, event-driven point tracker.

Source: N. Funk et al., "Evetac: an event-based optical tactile sensor for robotic manipulation",
IEEE Transactions on Robotics 40, 2024 (doi:10.1109/TRO.2024.3428430), and the formulas of its
public tracker, which is written for 640x480 px and dots at a mean pitch of 61.3 px.

Re-derived: every slice of 1 ms pulls each dot towards the events in a ring around it, against a
regulariser that keeps the calibrated distances to the neighbours. Polarity is not used. A
background-activity filter (100 ms) goes first. No term pulls a dot back to its rest position. The
stored "radius" of the original is a blob detector's keypoint size, which is a diameter: the ring
must reach two to three times the disc's radius, or the dots do not follow at all.

Differences: lengths are scaled by the ratio of the pitches (37 to 61.3 px here), and the
regulariser by its square, since it is cubic in length. Gain, reach and gate depend on the number of
events that the edge of a dot causes per pixel of motion; they were tuned on separate training
scenes (``benchmarks/tune_baselines.py``). Slices are never merged, because offline tracking never
falls behind. The public sources have two strengths of the regulariser, a factor of 333 apart; both
are run.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac import Calibration
from spikingtac.calibration import marker_pitch_px
from spikingtac.events import BackgroundActivityFilter, HotPixelFilter
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

SOURCE_PITCH_PX = 61.3  # Mean pitch of the original's dots, px. The following lengths refer to it.
SOURCE_RING_PX = 13.75  # Width of the ring in which events count, px at the original's pitch.
# Largest calibrated distance of a neighbour, px at the original's pitch: the eight around.
SOURCE_NEIGHBOUR_PX = 105.0
SOURCE_CLAMP_PX = 400.0  # Largest component of the summed attraction, px at the original's pitch.
SOURCE_CAP_PX = 1.2  # Largest step per slice and axis, px at the original's pitch.
RATE_HZ = 500.0  # Rate at which the dots are read out, Hz; they move in slices at any rate.
SLICE_US = 1_000  # Length of a slice, us (original: 1 ms).
TURN_RATIO = 1.25  # R divided by the outer radius of the ring (original).


# Of the older variant of the original, which applies 7.5e-5 outside of the gain. At the original's
# gain of 0.003 such a regulariser overshoots in every slice. Its gain was tuned separately, behind
# the original's filter.
STRONG: dict[str, Any] = {"gain": 1e-4, "regularizer": 7.5e-5 / 0.003, "support_us": 100_000}


class EvetacTracker:
    """Tracks each dot by the events around it. A dot with too few events does not move."""

    def __init__(
        self,
        calibration: Calibration,
        *,
        gain: float = 0.002,
        regularizer: float = 7.5e-5,
        reach_ratio: float = 2.2,
        gate: int = 4,
        support_us: int = 50_000,
    ) -> None:
        """Start at the calibrated rest positions.

        Args:
            calibration: Rest positions of the markers; polarity is not used.
            gain: Step per unit of attraction (original: 0.003; tuned).
            regularizer: Weight of the regulariser, inside of the gain (original: 7.5e-5).
            reach_ratio: Outer radius of the ring divided by the disc's radius (original: 1 / 0.3 to
                1 / 0.5; tuned).
            gate: Smallest number of non-zero components of the attraction per slice (original: 10,
                about 5 events; tuned).
            support_us: Window of the background-activity filter, us (original: 100 ms; tuned).
        """
        self._calibration, self._gate, self._support_us = calibration, gate, support_us
        self._gain, self._regularizer = gain, regularizer
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        rest_px = calibration.reference_px.astype(np.float64)
        pitch_px = marker_pitch_px(rest_px) if len(rest_px) > 1 else SOURCE_PITCH_PX
        self._scale = pitch_px / SOURCE_PITCH_PX
        self._outer_px = reach_ratio * float(calibration.radius_px.mean())
        away_px = np.linalg.norm(rest_px[:, None] - rest_px, axis=2)
        near = (away_px > 0.0) & (away_px < SOURCE_NEIGHBOUR_PX * self._scale)
        self._neighbour_px = np.where(near, away_px, np.nan)
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        """Take in all events of the next packet. Complete slices move the dots."""
        packet = self._filter(self._hot.kept(packet))
        waiting = EventPacket.concatenate([*self._waiting, packet])
        number = waiting.t // SLICE_US
        complete = int(np.searchsorted(number, waiting.t_end_us // SLICE_US))
        cuts = np.flatnonzero(np.diff(number[:complete])) + 1
        for first, last in itertools.pairwise([0, *cuts.tolist(), complete]):
            # A slice without events changes nothing.
            if first < last:
                self._advance(waiting.x[first:last], waiting.y[first:last])
        ends_us = waiting.t_start_us, waiting.t_end_us
        self._waiting = [waiting.part(complete, len(waiting), *ends_us)]

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the dots after the last complete slice before ``t_us``."""
        coasted = self._support < self._gate
        given, moved = self._center_px.copy(), self._center_px - self._calibration.reference_px
        return MarkerFrame(t_us, given, given, moved, coasted, np.where(coasted, 0.0, 1.0))

    def reset(self) -> None:
        """Return to the calibrated rest positions."""
        self._filter = BackgroundActivityFilter(self._calibration.size, self._support_us)
        self._waiting: list[EventPacket] = []
        self._center_px: FloatArray = self._calibration.reference_px.astype(np.float64)
        self._support = np.zeros(len(self._center_px), np.int64)

    def _advance(self, x: NDArray[np.uint16], y: NDArray[np.uint16]) -> None:
        """Move the dots by the events of one slice."""
        scale = self._scale
        inner_px = max(self._outer_px - SOURCE_RING_PX * scale, 0.0)
        pull, self._support = attraction(x, y, self._center_px, (inner_px, self._outer_px))
        clamp_px, cap_px = SOURCE_CLAMP_PX * scale, SOURCE_CAP_PX * scale
        weight = self._regularizer / scale**2
        held = weight * regularizer(self._center_px, self._neighbour_px)
        step_px = self._gain * (pull.clip(-clamp_px, clamp_px) - held)
        step_px[self._support < self._gate] = 0.0
        self._center_px -= step_px.clip(-cap_px, cap_px)


def attraction(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    center_px: FloatArray,
    ring_px: tuple[float, float],
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Sum g = 2 (d - R d / rho) over the events in each dot's ring.

    Args:
        x: ``(n,)`` columns, px.
        y: ``(n,)`` rows, px.
        center_px: ``(m, 2)`` dots, px.
        ring_px: Inner and outer radius of the ring, px. R lies beyond the outer one.

    Returns:
        The sums ``(m, 2)``, and the numbers ``(m,)`` of non-zero components of g.
    """
    inner_px, outer_px = ring_px
    # Towards zero, as a conversion to integers does in the original's table.
    dx, dy = np.trunc(x[:, None] - center_px[:, 0]), np.trunc(y[:, None] - center_px[:, 1])
    rho = np.maximum(np.hypot(dx, dy), 1.0)
    inside = (rho > inner_px) & (rho <= outer_px)
    weight = np.where(inside, 2.0 * (1.0 - TURN_RATIO * outer_px / rho), 0.0)
    pull = np.column_stack([(weight * dx).sum(axis=0), (weight * dy).sum(axis=0)])
    return pull, (inside & (dx != 0.0)).sum(axis=0) + (inside & (dy != 0.0)).sum(axis=0)


def regularizer(center_px: FloatArray, neighbour_px: FloatArray) -> FloatArray:
    """Return h_i = 4 sum_j (c_j - c_i)(|c_j - c_i|^2 - D_ij^2), times 8 / (number of neighbours).

    Args:
        center_px: ``(m, 2)`` dots, px.
        neighbour_px: ``(m, m)`` calibrated distances D_ij, px; nan of those that are no neighbours.
    """
    offset_px = center_px[None] - center_px[:, None]
    excess = np.nan_to_num((offset_px**2).sum(axis=2) - neighbour_px**2)
    count = np.maximum(np.isfinite(neighbour_px).sum(axis=1), 1)[:, None]
    return 32.0 / count * np.einsum("ij,ijk->ik", excess, offset_px)
