"""The rig without contact, many times faster than :class:`~spikingtac.sim.rig.rig.Rig`.

It replaces the rig while the arm cruises and nothing touches the probe.
``tests/integration/test_contact_free.py`` compares mean, variance over mean, signed statistics and
false-stop rate with those of the rig.

Without contact the rod is a linear system. Its impulse response is computed with
:class:`~spikingtac.sim.rig.probe.Probe` itself, so that minutes of motion are one convolution.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, oaconvolve

from spikingtac.arrays import FloatArray
from spikingtac.sim import (
    FingerConfig,
    MarkerImage,
    NoWall,
    Pad,
    Probe,
    ProbeConfig,
    RigConfig,
    SensingFinger,
    SkinState,
    Vibration,
    transition,
)
from spikingtac.types import EventPacket
from spikingtac_paper.free_motion.small_motion_camera import (
    DEGREES_OF_FREEDOM,
    SLOPE_STEP,
    STEP_S,
    SmallMotionCamera,
)

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
        config: The rod and its bushing.
        vibration: Vibration of the arm. A part of the length of the impulse response is drawn
            first, so that the rod does not start from rest.
    """

    def __init__(self, config: ProbeConfig, vibration: VibrationPath) -> None:
        self._response = impulse_response(config)
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


@functools.lru_cache(maxsize=8)
def impulse_response(config: ProbeConfig) -> FloatArray:
    """Return ``(taps, 3, 6)``: the bushing after the arm was at 1 mm for one step, per axis."""
    taps = round(RESPONSE_S / STEP_S)
    response = np.empty((taps, AXES, DEGREES_OF_FREEDOM))
    for axis in range(AXES):
        probe = Probe(config, NoWall(), np.zeros(AXES))
        for tap in range(taps):
            arm_mm = np.zeros(AXES)
            arm_mm[axis] = float(tap == 0)
            response[tap, axis] = probe.step(tap + 1, STEP_S, arm_mm).bushing
    return response


def skin_state(pad: Pad, config: ProbeConfig, bushing: FloatArray) -> SkinState:
    """Return the skin of a pad under a free probe with bushing displacement ``(6,)`` (mm, rad)."""
    at_rest = Probe(config, NoWall(), np.zeros(AXES)).at_rest(0)
    return pad.skin(replace(at_rest, bushing=bushing))


# Seed and length (steps of 1 ms) of the vibration that gives the bushing's covariance.
#
# Two minutes give it to 3 %.
COVARIANCE_SEED, COVARIANCE_STEPS = 0, 120_000


class SmallMotionFinger(SensingFinger):
    """A sensing finger whose markers move by a small amount only.

    Args:
        config: Optics, camera and individual sensor.
        seed: Seed of its noise.
        pad: The pad that its camera sees.
        rig: The probe and the vibration that moves it.
    """

    def __init__(self, config: FingerConfig, seed: int, pad: Pad, rig: RigConfig) -> None:
        super().__init__(config, seed)
        self.sparse_camera = SmallMotionCamera(config.camera_config, seed, config.serial)
        self.camera = self.sparse_camera
        self._pad, self._probe = pad, rig.probe
        self.image = self._at(np.zeros(DEGREES_OF_FREEDOM))
        self.settle(self.image)
        steps = SLOPE_STEP * np.eye(DEGREES_OF_FREEDOM)
        pairs = [(self._at(step), self._at(-step)) for step in steps]
        self.slopes = np.stack(
            [(forth.center_px - back.center_px) / (2 * SLOPE_STEP) for forth, back in pairs],
            axis=-1,
        )
        self.sparse_camera.linearise(self.image, pairs, bushing_covariance(rig))

    def _at(self, bushing: NDArray[np.float64]) -> MarkerImage:
        return self.project(skin_state(self._pad, self._probe, bushing))


class FreeRig:
    """A finger on a free probe under the vibration of the cruising arm.

    Args:
        config: Probe, pads and vibration.
        finger: The finger, on pad A.
        seed: Seed of its noise.
        rng: Source of the vibration.
    """

    def __init__(
        self, config: RigConfig, finger: FingerConfig, seed: int, rng: np.random.Generator
    ) -> None:
        self._motion = FreeMotion(config.probe, VibrationPath(config.vibration_mm, rng))
        self._finger = SmallMotionFinger(finger, seed, Pad(), config)

    @property
    def image(self) -> MarkerImage:
        """The markers at rest."""
        return self._finger.image

    def advance(self, steps: int) -> tuple[EventPacket, NDArray[np.float64]]:
        """Advance by a number of milliseconds.

        Returns:
            The events, and the true marker centres ``(steps, m, 2)`` to first order, px.
        """
        bushing = self._motion.advance(steps)
        moved_px = np.einsum("mcf,sf->smc", self._finger.slopes, bushing)
        return self._finger.sparse_camera.render_motion(bushing), self.image.center_px + moved_px


@functools.lru_cache(maxsize=16)
def bushing_covariance(config: RigConfig) -> NDArray[np.float64]:
    """Return the covariance ``(6, 6)`` of a free probe's bushing under the vibration of the arm."""
    vibration = VibrationPath(config.vibration_mm, np.random.default_rng(COVARIANCE_SEED))
    bushing = FreeMotion(config.probe, vibration).advance(COVARIANCE_STEPS)
    return bushing.T @ bushing / len(bushing)
