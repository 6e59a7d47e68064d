"""The event camera in front of markers that only sway: the same pixels, visited only when due.

Specimen (thresholds, leak, hot pixels), background, dead times, latencies and readout are those of
:class:`~spikingtac.sim.camera.camera.EventCamera`; only the light around the edges is computed
otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from spikingtac.sim.camera.camera import EventCamera
from spikingtac.sim.camera.config import CameraConfig
from spikingtac.sim.camera.noise import noise_kernel
from spikingtac.sim.camera.pixel_coverage import discs_of
from spikingtac.sim.free_motion.free_motion import FREEDOMS, STEP_S
from spikingtac.sim.free_motion.small_motion import (
    EDGE_DTYPE,
    Rims,
    lag_coefficients,
    small_motion_kernel,
)
from spikingtac.sim.free_motion.timing_wheel import NOBODY, make_timing_wheel
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.types import EventPacket

STEP_US = STEP_S * 1e6
BLOCK_STEPS = 200
"""Steps between two looks at the outbox."""
OUTBOX = 1 << 18
"""Events that a block may bring: 1.3 Mev/s, ten times the ``noisy`` preset."""
WHEEL_STEPS = 1 << 15
"""Longest sleep of a pixel, in steps."""
FAR_SIGMAS = 6.0
"""Sway beyond which a sleeping pixel may wake too late: less often than once in ten hours."""
LAGS = 6
"""Photoreceptors of so many speeds stand for all; neighbours differ by a third."""
AROUND_PX = 8.0
"""Pixels farther outside of every edge see no marker: edges reach 3 px, sway 1 px."""
PROBING = 1e-3
"""Displacement (mm, rad) by which the slopes are taken: 0.02 px."""


class SmallMotionCamera(EventCamera):
    """An event camera whose markers sway with a free probe.

    Args:
        config: The sensor.
        seed: Of the noise.
        serial: Which sensor.
    """

    def __init__(self, config: CameraConfig, seed: int, serial: int | None = None) -> None:
        super().__init__(config, seed, serial)
        self._lags_us = np.zeros(0)

    def follow(
        self,
        image: MarkerImage,
        swayed: Sequence[tuple[MarkerImage, MarkerImage]],
        sigma: NDArray[np.float64],
    ) -> None:
        """Learn how the light depends on the rod's motion; call it after :meth:`settle`.

        Args:
            image: The markers at rest.
            swayed: The same after a small step forth and back in each freedom of the bushing.
            sigma: ``(6, 6)`` covariance of the bushing.
        """
        inside = edge_distance_px(image, self.size)
        slope = np.stack(
            [
                (edge_distance_px(forth, self.size) - edge_distance_px(back, self.size))
                / (2.0 * PROBING)
                for forth, back in swayed
            ],
            axis=-1,
        )
        away_px = FAR_SIGMAS * np.sqrt(np.einsum("...i,ij,...j->...", slope, sigma, slope))
        reach_px = float(self._sensor.chip["reach_px"][0])
        near = np.flatnonzero((np.abs(inside) < reach_px + away_px).ravel())
        edges = np.zeros(len(near), EDGE_DTYPE)
        edges["inside_px"] = inside.ravel()[near]
        ends = [
            self._levels(near, edges["inside_px"] + side * away_px.ravel()[near])
            for side in (-1.0, 1.0)
        ]
        edges["lowest"], edges["highest"] = np.sort(ends, axis=0)
        self._begin(near, edges, slope.reshape(-1, FREEDOMS)[near])

    def _begin(
        self, near: NDArray[np.intp], edges: NDArray[Any], slopes: NDArray[np.float64]
    ) -> None:
        chip, flat = self._sensor.chip[0], self._sensor.pixels.reshape(-1)
        flat["level"][near] = flat["target"][near] = self._levels(near, edges["inside_px"])
        flat["before"] = flat["intensity"]
        lag_us = 1.0 / (float(chip["rate"]) * (flat["intensity"][near] + float(chip["dark"])))
        self._lags_us = np.geomspace(lag_us.min(), lag_us.max(), LAGS)
        edges["slope"] = slopes
        edges["lag"] = np.abs(np.log(lag_us[:, None] / self._lags_us)).argmin(axis=1)
        place = np.full(len(flat), NOBODY, np.int32)
        place[near] = np.arange(len(near))
        self._rims = Rims(edges, place)
        self._beds = make_timing_wheel(len(flat), WHEEL_STEPS)
        self._past = np.zeros((LAGS, 1, FREEDOMS))
        self._last = np.zeros((LAGS, FREEDOMS), np.float32)
        self._out = np.zeros(OUTBOX, np.int64)

    def sway(self, bushing: NDArray[np.float64]) -> EventPacket:
        """Return the events of ``(steps, 6)`` of the rod's motion, one step per millisecond."""
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
            self._rims,
            sensor.chip[0],
            self._beds,
            motion,
            float(start_us),
            STEP_US,
            self._out,
        )
        end_us = start_us + round((motion.shape[2] - 1) * STEP_US)
        while not noise_kernel(self._noise, float(end_us), self._out):
            self._drain()
        self._drain()
        self._t_us = end_us
        return self._readout.release(end_us)

    def _low_passed(self, bushing: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return ``(lags, 6, 1 + steps)`` what photoreceptors of each speed see of a motion."""
        out = np.empty((LAGS, FREEDOMS, 1 + len(bushing)), np.float32)
        out[..., 0] = self._last
        for k, lag_us in enumerate(self._lags_us):
            b, a = lag_coefficients(lag_us, STEP_US)
            seen, self._past[k] = lfilter(b, a, bushing, axis=0, zi=self._past[k])
            out[k, :, 1:] = seen.T
        self._last = out[..., -1].copy()
        return out

    def _levels(
        self, pixels: NDArray[np.intp], inside_px: NDArray[np.floating[Any]]
    ) -> NDArray[np.float64]:
        """Return the log light of pixels at a distance inside the edge."""
        chip, flat = self._sensor.chip[0], self._sensor.pixels.reshape(-1)
        place = (inside_px + chip["reach_px"]) * chip["edge_per_px"]
        covered = np.interp(place, np.arange(len(chip["edge"])), chip["edge"])
        light = flat["base"][pixels] + flat["lift"][pixels] * covered
        return np.interp(light * chip["log_per_unit"], np.arange(len(chip["log"])), chip["log"])


def edge_distance_px(image: MarkerImage, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return ``(height, width)`` how far each pixel lies inside the nearest disc's edge, px.

    Args:
        image: Whole discs; a broken one's chord is not looked at.
        size: ``(width, height)``.
    """
    inside = np.full((size[1], size[0]), -AROUND_PX)
    for disc in discs_of(image):
        reach = disc["radius"] / disc["scale"] + 2.0 * AROUND_PX
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
