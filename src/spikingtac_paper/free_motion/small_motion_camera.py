"""The event camera for small motions: a pixel is updated only when an event may be near.

Mismatch, leak, hot pixels, background, dead times, latencies and readout are those of the
:class:`~spikingtac.sim.EventCamera`. Only the light around the edges is computed in another way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from spikingtac.sim import (
    CameraConfig,
    EventCamera,
    MarkerImage,
    background_events_kernel,
    discs_of,
)
from spikingtac.types import EventPacket
from spikingtac_paper.free_motion.small_motion import (
    EDGE_DTYPE,
    EMPTY,
    EdgePixels,
    make_timing_wheel,
    small_motion_kernel,
)

DEGREES_OF_FREEDOM = 6  # Translations and rotations of the rod against the pads.
STEP_S = 0.001  # Step of the mechanics, s; the same as that of the rig away from the wall.
STEP_US = STEP_S * 1e6  # Step of the motion, us.
BLOCK_STEPS = 200  # Steps between two readings of the event buffer.

# Capacity of the event buffer for one block: 1.3 Mev/s, ten times the ``noisy`` preset.
OUTBOX = 1 << 18
WHEEL_SLOTS = 1 << 15  # Longest wait of a pixel, in steps.

# Range of motion that a waiting pixel allows for; it is left less than once in ten hours.
RANGE_SIGMAS = 6.0
LAGS = 6  # Number of photoreceptor time constants that stand for all; neighbours differ by a third.

# Distance outside an edge beyond which no marker is seen: edges reach 3 px, motion 1 px.
FAR_OUTSIDE_PX = 8.0

# Displacement (mm, rad) with which the slopes are taken; it moves a marker by 0.02 px.
SLOPE_STEP = 1e-3


class SmallMotionCamera(EventCamera):
    """An event camera whose markers move with a free probe.

    Args:
        config: Settings of the sensor.
        seed: Seed of the noise.
        serial: Number of the individual sensor.
    """

    def __init__(self, config: CameraConfig, seed: int, serial: int | None = None) -> None:
        super().__init__(config, seed, serial)
        self._lags_us = np.zeros(0)

    def linearise(
        self,
        image: MarkerImage,
        displaced: Sequence[tuple[MarkerImage, MarkerImage]],
        sigma: NDArray[np.float64],
    ) -> None:
        """Store how the light depends on the motion of the rod. Call it after :meth:`settle`.

        Args:
            image: The markers at rest.
            displaced: Images after a small step forwards and backwards in each degree of freedom of
                the bushing.
            sigma: ``(6, 6)`` covariance of the bushing (mm and rad).
        """
        inside = edge_distance_px(image, self.size)
        slope = np.stack(
            [
                (edge_distance_px(forth, self.size) - edge_distance_px(back, self.size))
                / (2.0 * SLOPE_STEP)
                for forth, back in displaced
            ],
            axis=-1,
        )
        away_px = RANGE_SIGMAS * np.sqrt(np.einsum("...i,ij,...j->...", slope, sigma, slope))
        reach_px = float(self._sensor.chip["edge_half_width_px"][0])
        near = np.flatnonzero((np.abs(inside) < reach_px + away_px).ravel())
        edges = np.zeros(len(near), EDGE_DTYPE)
        edges["inside_px"] = inside.ravel()[near]
        ends = [
            self._levels(near, edges["inside_px"] + side * away_px.ravel()[near])
            for side in (-1.0, 1.0)
        ]
        edges["lowest_level"], edges["highest_level"] = np.sort(ends, axis=0)
        self._initialise(near, edges, slope.reshape(-1, DEGREES_OF_FREEDOM)[near])

    def _initialise(
        self, near: NDArray[np.intp], edges: NDArray[Any], slopes: NDArray[np.float64]
    ) -> None:
        chip, flat = self._sensor.chip[0], self._sensor.pixels.reshape(-1)
        flat["level"][near] = flat["target_level"][near] = self._levels(near, edges["inside_px"])
        flat["previous_intensity"] = flat["intensity"]
        lag_us = 1.0 / (
            float(chip["white_rate_per_us"]) * (flat["intensity"][near] + float(chip["dark"]))
        )
        self._lags_us = np.geomspace(lag_us.min(), lag_us.max(), LAGS)
        edges["slope"] = slopes
        edges["filter_index"] = np.abs(np.log(lag_us[:, None] / self._lags_us)).argmin(axis=1)
        record = np.full(len(flat), EMPTY, np.int32)
        record[near] = np.arange(len(near))
        self._edge_pixels = EdgePixels(edges, record)
        self._wheel = make_timing_wheel(len(flat), WHEEL_SLOTS)
        self._filter_state = np.zeros((LAGS, 1, DEGREES_OF_FREEDOM))
        self._previous = np.zeros((LAGS, DEGREES_OF_FREEDOM), np.float32)
        self._out = np.zeros(OUTBOX, np.int64)

    def render_motion(self, bushing: NDArray[np.float64]) -> EventPacket:
        """Return the events of a motion ``(steps, 6)`` of the rod (mm, rad), one step per ms."""
        start_us = self._t_us
        assert start_us is not None
        motion = self._low_passed(bushing)
        parts = []
        for first in range(0, len(bushing), BLOCK_STEPS):
            part = motion[..., first : first + BLOCK_STEPS + 1]
            parts.append(self._block(np.ascontiguousarray(part)))
        assert self._t_us is not None
        return self._readout.packet(parts, start_us, self._t_us)

    def _block(self, motion: NDArray[np.float32]) -> NDArray[np.int64]:
        assert self._t_us is not None
        sensor, start_us = self._sensor, self._t_us
        small_motion_kernel(
            sensor.pixels.reshape(-1),
            self._edge_pixels,
            sensor.chip[0],
            self._wheel,
            motion,
            float(start_us),
            STEP_US,
            self._out,
        )
        end_us = start_us + round((motion.shape[2] - 1) * STEP_US)
        while not background_events_kernel(self._noise, float(end_us), self._out):
            self._drain()
        self._drain()
        self._t_us = end_us
        return self._readout.release(end_us)

    def _low_passed(self, bushing: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the motion ``(filters, 6, 1 + steps)`` as photoreceptors of each speed see it."""
        out = np.empty((LAGS, DEGREES_OF_FREEDOM, 1 + len(bushing)), np.float32)
        out[..., 0] = self._previous
        for k, lag_us in enumerate(self._lags_us):
            b, a = lag_coefficients(lag_us, STEP_US)
            seen, self._filter_state[k] = lfilter(b, a, bushing, axis=0, zi=self._filter_state[k])
            out[k, :, 1:] = seen.T
        self._previous = out[..., -1].copy()
        return out

    def _levels(
        self, pixels: NDArray[np.intp], inside_px: NDArray[np.floating[Any]]
    ) -> NDArray[np.float64]:
        """Return the log intensity of pixels at a distance inside the edge, px."""
        chip, flat = self._sensor.chip[0], self._sensor.pixels.reshape(-1)
        record = (inside_px + chip["edge_half_width_px"]) * chip["edge_per_px"]
        covered = np.interp(record, np.arange(len(chip["edge_coverage"])), chip["edge_coverage"])
        light = flat["ground_intensity"][pixels] + flat["marker_increment"][pixels] * covered
        return np.interp(
            light * chip["log_per_unit"],
            np.arange(len(chip["log_intensity"])),
            chip["log_intensity"],
        )


def edge_distance_px(image: MarkerImage, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return ``(height, width)`` how far each pixel lies inside the nearest disc's edge, px.

    Args:
        image: Image of whole discs; chords of broken discs are ignored.
        size: ``(width, height)`` of the sensor, px.
    """
    inside = np.full((size[1], size[0]), -FAR_OUTSIDE_PX)
    for disc in discs_of(image):
        reach = disc["radius"] / disc["scale"] + 2.0 * FAR_OUTSIDE_PX
        rows, columns = (
            slice(max(int(disc[axis] - reach), 0), max(int(disc[axis] + reach) + 1, 0))
            for axis in ("y", "x")
        )
        y, x = np.mgrid[rows, columns][:, : size[1] - rows.start, : size[0] - columns.start]
        dx, dy = x - disc["x"], y - disc["y"]
        u = disc["xx"] * dx + disc["xy"] * dy
        v = disc["yx"] * dx + disc["yy"] * dy
        found = (disc["radius"] - np.hypot(u, v)) / disc["scale"]
        part = inside[rows, columns]
        np.maximum(part, found, out=part)
    return inside


def lag_coefficients(lag_us: float, step_us: float) -> tuple[list[float], list[float]]:
    """Return the filter (b, a) of a first-order low-pass for a piecewise linear input."""
    steps = lag_us / step_us
    decay = math.exp(-1.0 / steps)
    rest = steps * (1.0 - decay)
    return [1.0 - rest, rest - decay], [1.0, -decay]
