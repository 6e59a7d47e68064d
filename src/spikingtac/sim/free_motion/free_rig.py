"""The rig without contact, many times faster than :class:`~spikingtac.sim.rig.rig.Rig`.

It replaces the rig while the arm cruises and nothing touches the probe.
``tests/integration/test_contact_free.py`` compares mean, variance over mean, signed statistics and
false-stop rate with those of the rig.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.windows import windows
from spikingtac.sim.free_motion.free_motion import (
    DEGREES_OF_FREEDOM,
    STEP_S,
    FreeMotion,
    skin_state,
)
from spikingtac.sim.free_motion.small_motion_camera import SLOPE_STEP, SmallMotionCamera
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.sim.rig.fingers import FingerConfig, SensingFinger
from spikingtac.sim.rig.pad import Pad
from spikingtac.sim.rig.rig import RigConfig
from spikingtac.sim.rig.vibration import Vibration
from spikingtac.sim.scene.scene import CameraChoice
from spikingtac.types import EventPacket

COVARIANCE_SEED, COVARIANCE_STEPS = 0, 120_000
"""Seed and length (steps of 1 ms) of the vibration that gives the bushing's covariance.

Two minutes give it to 3 %.
"""
CHUNK_STEPS = 10_000


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
        choice = CameraChoice(preset=config.camera, settings=config.settings)
        self.sparse_camera = SmallMotionCamera(
            choice.resolve(config.optics.size), seed, config.serial
        )
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
    """Fingers on a free probe under the vibration of the cruising arm.

    Args:
        config: Probe, pads and vibration.
        fingers: One or two fingers; the first is pad A.
        seeds: Seed of each finger's noise.
        rng: Source of the vibration.
    """

    def __init__(
        self,
        config: RigConfig,
        fingers: Sequence[FingerConfig],
        seeds: Sequence[int],
        rng: np.random.Generator,
    ) -> None:
        self._motion = FreeMotion(config.probe, Vibration(config.vibration, rng))
        self._fingers = [
            SmallMotionFinger(
                finger, seed, Pad(config.pad, config.patch, faces_back=bool(number)), config
            )
            for number, (finger, seed) in enumerate(zip(fingers, seeds, strict=True))
        ]

    @property
    def images(self) -> tuple[MarkerImage, ...]:
        """The markers at rest, one image for each sensor."""
        return tuple(finger.image for finger in self._fingers)

    def advance(
        self, steps: int
    ) -> tuple[tuple[EventPacket, ...], tuple[NDArray[np.float64], ...]]:
        """Advance by a number of milliseconds.

        Returns:
            The events of each sensor, and its true marker centres ``(steps, m, 2)`` to first order,
            px.
        """
        bushing = self._motion.advance(steps)
        packets = tuple(finger.sparse_camera.render_motion(bushing) for finger in self._fingers)
        markers = tuple(
            finger.image.center_px + np.einsum("mcf,sf->smc", finger.slopes, bushing)
            for finger in self._fingers
        )
        return packets, markers

    def windows(self, steps: int, period_us: int = 1000, sensor: int = 0) -> Iterator[EventPacket]:
        """Yield the windows of one sensor over a number of milliseconds."""
        chunks = (
            self.advance(min(CHUNK_STEPS, steps - first))[0][sensor]
            for first in range(0, steps, CHUNK_STEPS)
        )
        return windows(chunks, period_us, silence_limit_us=None)


@functools.lru_cache(maxsize=16)
def bushing_covariance(config: RigConfig) -> NDArray[np.float64]:
    """Return the covariance ``(6, 6)`` of a free probe's bushing under the vibration of the arm."""
    vibration = Vibration(config.vibration, np.random.default_rng(COVARIANCE_SEED))
    bushing = FreeMotion(config.probe, vibration).advance(COVARIANCE_STEPS)
    return bushing.T @ bushing / len(bushing)


__all__ = ["STEP_S", "FreeRig", "SmallMotionFinger", "bushing_covariance"]
