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

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac import Calibration
from spikingtac.calibration import marker_pitch_px
from spikingtac.events import BackgroundActivityFilter, HotPixelFilter
from spikingtac.types import EventPacket, MarkerFrame

SOURCE_PITCH_PX = 61.3  # Mean pitch of the original's dots, px. The following lengths refer to it.

SOURCE_RING_PX = 13.75  # Width of the ring in which events count, px at the original's pitch.

# Largest calibrated distance of a neighbour, px at the original's pitch: the eight around.
SOURCE_NEIGHBOUR_PX = 105.0

SOURCE_CLAMP_PX = 400.0  # Largest component of the summed attraction, px at the original's pitch.

SOURCE_CAP_PX = 1.2  # Largest step per slice and axis, px at the original's pitch.


RATE_HZ = 500.0  # Rate at which the dots are read out, Hz; they move in slices at any rate.

SLICE_US = 1_000  # Length of a slice, us (original: 1 ms).

TURN_RATIO = 1.25  # R divided by the outer radius of the ring (original).


@dataclass(frozen=True, kw_only=True, slots=True)
class EvetacConfig:
    """Parameters of the original that were tuned for another sensor.

    Attributes:
        gain: Step per unit of attraction (original: 0.003).
        regularizer: Weight of the regulariser, inside of the gain (original: 7.5e-5).
        reach_ratio: Outer radius of the ring divided by the disc's radius (original: 1 / 0.3 to 1 /
            0.5).
        gate: Smallest number of non-zero components of the attraction per slice (original: 10,
            about 5 events).
        support_us: Window of the background-activity filter, us (original: 100 ms; tuned).
    """

    gain: float = 0.002
    regularizer: float = 7.5e-5
    reach_ratio: float = 2.2
    gate: int = 4
    support_us: int = 50_000

    @classmethod
    def strong(cls) -> Self:
        """Return the older variant of the original, which applies 7.5e-5 outside of the gain.

        At the original's gain of 0.003 such a regulariser overshoots in every slice. Its gain was
        tuned separately, behind the original's filter.
        """
        return cls(gain=1e-4, regularizer=7.5e-5 / 0.003, support_us=100_000)


class EvetacTracker:
    """Tracks each dot by the events around it. A dot with too few events does not move."""

    def __init__(self, config: EvetacConfig, calibration: Calibration) -> None:
        """Start at the calibrated rest positions.

        Args:
            config: Parameters.
            calibration: Rest positions of the markers; polarity is not used.
        """
        self._config, self._calibration = config, calibration
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        many = len(calibration.reference_px) > 1
        pitch_px = marker_pitch_px(calibration.reference_px) if many else SOURCE_PITCH_PX
        self._scale = pitch_px / SOURCE_PITCH_PX
        self._outer_px = config.reach_ratio * float(calibration.radius_px.mean())
        reach_px = SOURCE_NEIGHBOUR_PX * self._scale
        self._neighbour, self._rest_px = neighbours(calibration.reference_px, reach_px)
        count = len(calibration.reference_px)
        self._pull, self._regularizer = np.empty((count, 2)), np.empty((count, 2))
        self._support = np.empty(count, np.int64)
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        """Take in all events of the next packet. Complete slices move the dots."""
        for part in self._slices.take(self._filter(self._hot.kept(packet))):
            self._advance(part)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the dots after the last complete slice before ``t_us``."""
        reference_px = self._calibration.reference_px
        coasted = self._support < self._config.gate
        return MarkerFrame(
            t_us=t_us,
            detected_px=self._center_px.copy(),
            position_px=self._center_px.copy(),
            displacement_px=self._center_px - reference_px,
            coasted=coasted,
            confidence=np.where(coasted, 0.0, 1.0),
        )

    def reset(self) -> None:
        """Return to the calibrated rest positions."""
        self._filter = BackgroundActivityFilter(self._calibration.size, self._config.support_us)
        self._slices = SliceBuffer(SLICE_US)
        self._center_px: NDArray[np.float64] = self._calibration.reference_px.astype(np.float64)
        self._support[:] = 0

    def _advance(self, part: EventPacket) -> None:
        config, scale = self._config, self._scale
        inner_px = max(self._outer_px - SOURCE_RING_PX * scale, 0.0)
        attraction_kernel(
            part.x,
            part.y,
            self._center_px,
            inner_px,
            self._outer_px,
            TURN_RATIO * self._outer_px,
            self._pull,
            self._support,
        )
        regularizer_kernel(self._center_px, self._neighbour, self._rest_px, self._regularizer)
        clamp_px = SOURCE_CLAMP_PX * scale
        weight = config.regularizer / scale**2
        step_px = config.gain * (self._pull.clip(-clamp_px, clamp_px) - weight * self._regularizer)
        step_px[self._support < config.gate] = 0.0
        cap_px = SOURCE_CAP_PX * scale
        self._center_px -= step_px.clip(-cap_px, cap_px)


def neighbours(
    reference_px: NDArray[np.float64], reach_px: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the neighbours of each marker and their distances.

    Args:
        reference_px: ``(m, 2)`` rest positions, px.
        reach_px: Largest distance of a neighbour, px.

    Returns:
        ``(m, k)`` indices, -1 beyond the last, and ``(m, k)`` distances, px.
    """
    offset = reference_px[:, None] - reference_px[None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    near = (distance < reach_px) & (distance > 0.0)
    width = max(int(near.sum(axis=1).max(initial=0)), 1)
    index = np.full((len(reference_px), width), -1, np.int64)
    rest_px = np.zeros(index.shape)
    for i, row in enumerate(near):
        found = np.flatnonzero(row)
        index[i, : len(found)], rest_px[i, : len(found)] = found, distance[i, found]
    return index, rest_px


@njit(cache=True)
def attraction_kernel(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    center_px: NDArray[np.float64],
    inner_px: float,
    outer_px: float,
    turn_px: float,
    pull: NDArray[np.float64],
    support: NDArray[np.int64],
) -> None:
    """Sum g = 2 (d - R d / rho) over the events in each dot's ring; count the non-zero components.

    Args:
        x: ``(n,)`` columns, px.
        y: ``(n,)`` rows, px.
        center_px: ``(m, 2)`` dots, px.
        inner_px: Inner radius of the ring, px.
        outer_px: Outer radius of the ring, px.
        turn_px: R, the radius at which attraction would become repulsion, px; larger than
            ``outer_px``.
        pull: ``(m, 2)`` sums g, overwritten.
        support: ``(m,)`` numbers of non-zero components of g, overwritten.
    """
    pull[:] = 0.0
    support[:] = 0
    for i in range(len(x)):
        for m in range(len(center_px)):
            # Towards zero, as a conversion to integers does in the original's table.
            dx = np.trunc(x[i] - center_px[m, 0])
            dy = np.trunc(y[i] - center_px[m, 1])
            if abs(dx) > outer_px or abs(dy) > outer_px:
                continue
            rho = max(np.sqrt(dx * dx + dy * dy), 1.0)
            if inner_px < rho <= outer_px:
                weight = 2.0 * (1.0 - turn_px / rho)
                pull[m, 0] += weight * dx
                pull[m, 1] += weight * dy
                support[m] += (dx != 0.0) + (dy != 0.0)


@njit(cache=True)
def regularizer_kernel(
    center_px: NDArray[np.float64],
    neighbour: NDArray[np.int64],
    rest_px: NDArray[np.float64],
    regularizer: NDArray[np.float64],
) -> None:
    """Write h_i = 4 sum_j (c_j - c_i)(|c_j - c_i|^2 - D_ij^2), times 8 / (number of neighbours).

    Args:
        center_px: ``(m, 2)`` dots, px.
        neighbour: ``(m, k)`` indices of the neighbours, -1 beyond the last.
        rest_px: ``(m, k)`` calibrated distances D_ij, px.
        regularizer: ``(m, 2)`` k_i h_i, overwritten.
    """
    for i in range(len(center_px)):
        sum_x, sum_y, count = 0.0, 0.0, 0
        for k in range(neighbour.shape[1]):
            j = neighbour[i, k]
            if j >= 0:
                dx = center_px[j, 0] - center_px[i, 0]
                dy = center_px[j, 1] - center_px[i, 1]
                excess = dx * dx + dy * dy - rest_px[i, k] ** 2
                sum_x += 4.0 * dx * excess
                sum_y += 4.0 * dy * excess
                count += 1
        border = 8.0 / count if count else 0.0
        regularizer[i, 0] = border * sum_x
        regularizer[i, 1] = border * sum_y


class SliceBuffer:
    """Joins and cuts packets into slices that begin at multiples of their length.

    Slices without events are omitted, because they do not change any tracker here.

    Args:
        slice_us: Length of a slice, us.
    """

    def __init__(self, slice_us: int) -> None:
        self._slice_us = slice_us
        self._pending: list[EventPacket] = []
        self._slice = 0

    def take(self, packet: EventPacket) -> Iterator[EventPacket]:
        """Yield the slices that ``packet`` completes."""
        number = packet.t // self._slice_us
        bounds = np.append(np.flatnonzero(np.diff(number)) + 1, len(packet))
        first = 0
        for last in bounds.tolist():
            if first == last:
                continue
            if self._pending and number[first] != self._slice:
                yield self._flush()
            self._slice = int(number[first])
            self._pending.append(packet.part(first, last, packet.t_start_us, packet.t_end_us))
            first = last
        if self._pending and packet.t_end_us >= (self._slice + 1) * self._slice_us:
            yield self._flush()

    def _flush(self) -> EventPacket:
        whole = EventPacket.concatenate(self._pending)
        self._pending = []
        return whole
