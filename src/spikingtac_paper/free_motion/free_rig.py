"""The rig without contact, many times faster than :class:`~spikingtac.sim.rig.rig.Rig`.

It replaces the rig while the arm cruises and nothing touches the probe.
``tests/integration/test_contact_free.py`` compares mean, variance over mean, signed statistics and
false-stop rate with those of the rig.

Without contact the rod is a linear system. Its impulse response is computed with
:class:`~spikingtac.sim.rig.probe.Probe` itself, so that minutes of motion are one convolution. In
the event camera a pixel is updated only when an event may be near. Mismatch, leak, hot pixels,
background, dead times, latencies and readout are those of
:class:`~spikingtac.sim.event_camera.EventCamera`.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, oaconvolve

from spikingtac.sim import (
    VIBRATION_MM,
    EventCamera,
    Grasp,
    MarkerImage,
    NoWall,
    Optics,
    OpticsConfig,
    Pad,
    Probe,
    ReferenceHistory,
    SkinState,
    Vibration,
    background_events_kernel,
    discs_of,
    grip_camera,
    transition,
)
from spikingtac.types import EventPacket, FloatArray
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
        preset: Its camera preset.
        size: ``(width, height)``, px.
        seed: Seed of the noise.
        serial: Number of the individual sensor.
    """

    def __init__(self, preset: str, size: tuple[int, int], seed: int, serial: int) -> None:
        super().__init__(grip_camera(preset), size, seed, serial)
        self._lags_us = np.zeros(0)

    def linearise(
        self,
        image: MarkerImage,
        displaced: Sequence[tuple[MarkerImage, MarkerImage]],
        sigma: FloatArray,
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

    def _initialise(self, near: NDArray[np.intp], edges: NDArray[Any], slopes: FloatArray) -> None:
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

    def render_motion(self, bushing: FloatArray) -> EventPacket:
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

    def _low_passed(self, bushing: FloatArray) -> NDArray[np.float32]:
        """Return the motion ``(filters, 6, 1 + steps)`` as photoreceptors of each speed see it."""
        out = np.empty((LAGS, DEGREES_OF_FREEDOM, 1 + len(bushing)), np.float32)
        out[..., 0] = self._previous
        for k, lag_us in enumerate(self._lags_us):
            b, a = lag_coefficients(lag_us)
            seen, self._filter_state[k] = lfilter(b, a, bushing, axis=0, zi=self._filter_state[k])
            out[k, :, 1:] = seen.T
        self._previous = out[..., -1].copy()
        return out

    def _levels(self, pixels: NDArray[np.intp], inside_px: NDArray[np.floating[Any]]) -> FloatArray:
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


def edge_distance_px(image: MarkerImage, size: tuple[int, int]) -> FloatArray:
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


def lag_coefficients(lag_us: float) -> tuple[list[float], list[float]]:
    """Return the filter (b, a) of a first-order low-pass for a piecewise linear input."""
    steps = lag_us / STEP_US
    decay = math.exp(-1.0 / steps)
    rest = steps * (1.0 - decay)
    return [1.0 - rest, rest - decay], [1.0, -decay]


AXES = 3

# Length of the impulse response, s: 25 decay times of the rocking mode (28 Hz, damping ratio
# 0.1). What the creep chain keeps for longer is below 0.1 % of the motion.
RESPONSE_S = 1.5


class VibrationPath(Vibration):
    """The vibration of the arm, many equal steps at once."""

    def path(self, steps: int, dt_s: float) -> FloatArray:
        """Return the displacements ``(steps, 3)`` of as many calls of :meth:`advance`, mm.

        The recursion is solved along the two complex modes of the resonance, which is many times as
        fast.
        """
        if self._rms_mm == 0.0:
            return np.zeros((steps, 3))
        move, noise = transition(round(dt_s * 1e9))
        drive = noise @ self._rng.standard_normal((steps, 2, 3))
        poles, modes = np.linalg.eig(move)
        to_modes = np.linalg.inv(modes)
        before, driven = to_modes @ self._state, to_modes @ drive
        state = np.stack(
            [
                lfilter([1.0], [1.0, -pole], driven[:, k], axis=0, zi=[pole * before[k]])[0]
                for k, pole in enumerate(poles)
            ],
            axis=1,
        )
        whole = np.real(modes @ state)
        self._state = whole[-1]
        return self._rms_mm * whole[:, 0]


class FreeMotion:
    """The motion of a probe without contact under the vibration of the arm.

    Args:
        vibration: Vibration of the arm. A part of the length of the impulse response is drawn
            first, so that the rod does not start from rest.
    """

    def __init__(self, vibration: VibrationPath) -> None:
        self._response = impulse_response()
        self._vibration = vibration
        self._previous_mm = vibration.path(len(self._response), STEP_S)

    def advance(self, steps: int) -> FloatArray:
        """Return the bushing ``(steps, 6)`` over the next ``steps`` milliseconds (mm and rad)."""
        shaken_mm = np.concatenate([self._previous_mm, self._vibration.path(steps, STEP_S)])
        moved = np.zeros((len(shaken_mm), DEGREES_OF_FREEDOM))
        for axis in range(AXES):
            driven = oaconvolve(shaken_mm[:, axis, None], self._response[:, axis], axes=0)
            moved += driven[: len(moved)]
        self._previous_mm = shaken_mm[-len(self._response) :]
        return moved[len(self._response) :]


@functools.cache
def impulse_response() -> FloatArray:
    """Return ``(taps, 3, 6)``: the bushing after the arm was at 1 mm for one step, per axis."""
    taps = round(RESPONSE_S / STEP_S)
    response = np.empty((taps, AXES, DEGREES_OF_FREEDOM))
    for axis in range(AXES):
        probe = Probe(Grasp(), NoWall(), np.zeros(AXES))
        for tap in range(taps):
            arm_mm = np.zeros(AXES)
            arm_mm[axis] = float(tap == 0)
            response[tap, axis] = probe.step(tap + 1, STEP_S, arm_mm).bushing
    return response


def skin_state(pad: Pad, bushing: FloatArray) -> SkinState:
    """Return the skin of a pad under a free probe with bushing displacement ``(6,)`` (mm, rad)."""
    at_rest = Probe(Grasp(), NoWall(), np.zeros(AXES)).at_rest(0)
    return pad.skin(replace(at_rest, bushing=bushing))


# Seed and length (steps of 1 ms) of the vibration that gives the bushing's covariance.
#
# Two minutes give it to 3 %.
COVARIANCE_SEED, COVARIANCE_STEPS = 0, 120_000


class FreeRig:
    """A finger on a free probe under the vibration of the cruising arm.

    Args:
        preset: Preset of camera and vibration.
        seed: Seed of noise and vibration.
        history: Initial reference levels of the pixels.
        serial: Number of the individual sensor.

    Attributes:
        camera: Its camera, whose markers move by a small amount only.
        image: The markers at rest.
    """

    def __init__(
        self, preset: str, seed: int, *, history: ReferenceHistory = "rested", serial: int = 1
    ) -> None:
        vibration = VibrationPath(VIBRATION_MM[preset], np.random.default_rng(seed))
        self._motion, self._pad, lens = FreeMotion(vibration), Pad(), OpticsConfig()
        self._optics = Optics(lens, serial)
        self.camera = SmallMotionCamera(preset, lens.size, seed, serial)
        self.image = self._at(np.zeros(DEGREES_OF_FREEDOM))
        self.camera.settle(self.image, history)
        steps = SLOPE_STEP * np.eye(DEGREES_OF_FREEDOM)
        pairs = [(self._at(step), self._at(-step)) for step in steps]
        self._slopes = np.stack(
            [(forth.center_px - back.center_px) / (2 * SLOPE_STEP) for forth, back in pairs],
            axis=-1,
        )
        self.camera.linearise(self.image, pairs, bushing_covariance(VIBRATION_MM[preset]))

    def _at(self, bushing: FloatArray) -> MarkerImage:
        return self._optics.project(skin_state(self._pad, bushing))

    def advance(self, steps: int) -> tuple[EventPacket, FloatArray]:
        """Advance by a number of milliseconds.

        Returns:
            The events, and the true marker centres ``(steps, m, 2)`` to first order, px.
        """
        bushing = self._motion.advance(steps)
        moved_px = np.einsum("mcf,sf->smc", self._slopes, bushing)
        return self.camera.render_motion(bushing), self.image.center_px + moved_px


@functools.lru_cache(maxsize=16)
def bushing_covariance(vibration_mm: float) -> FloatArray:
    """Return the covariance ``(6, 6)`` of a free probe's bushing under the vibration of the arm."""
    vibration = VibrationPath(vibration_mm, np.random.default_rng(COVARIANCE_SEED))
    bushing = FreeMotion(vibration).advance(COVARIANCE_STEPS)
    return bushing.T @ bushing / len(bushing)
