"""Contact-free minutes of the rig, many times faster than the whole twin.

Stands in for :class:`~spikingtac.sim.rig.rig.Rig` while the arm cruises and nothing touches the
probe. ``tests/integration/test_contact_free.py`` holds it to the whole twin's mean, variance over
mean, signed statistics and rate of false stops.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.windows import windows
from spikingtac.sim.free_motion.free_motion import FREEDOMS, STEP_S, FreeMotion, swayed_skin
from spikingtac.sim.free_motion.small_motion_camera import PROBING, SmallMotionCamera
from spikingtac.sim.optics.states import MarkerImage
from spikingtac.sim.rig.fingers import FingerConfig, SensingFinger
from spikingtac.sim.rig.pad_modes import Pad
from spikingtac.sim.rig.rig import RigConfig
from spikingtac.sim.rig.vibration import Vibration
from spikingtac.sim.scene.scene import CameraChoice
from spikingtac.types import EventPacket

COVARIANCE_SEED, COVARIANCE_STEPS = 0, 120_000
"""Two minutes tell the sway's covariance to 3 %."""
CHUNK_STEPS = 10_000


class SmallMotionFinger(SensingFinger):
    """A sensing finger whose markers only sway.

    Args:
        config: What it is.
        seed: Of its noise.
        pad: The pad that it sees.
        rig: The probe, and the vibration that sways it.
    """

    def __init__(self, config: FingerConfig, seed: int, pad: Pad, rig: RigConfig) -> None:
        super().__init__(config, seed)
        choice = CameraChoice(preset=config.camera, settings=config.settings)
        self.swaying = SmallMotionCamera(choice.resolve(config.optics.size), seed, config.serial)
        self.camera = self.swaying
        self._pad, self._probe = pad, rig.probe
        self.image = self._at(np.zeros(FREEDOMS))
        self.settle(self.image)
        steps = PROBING * np.eye(FREEDOMS)
        pairs = [(self._at(step), self._at(-step)) for step in steps]
        self.slopes = np.stack(
            [(forth.center_px - back.center_px) / (2 * PROBING) for forth, back in pairs], axis=-1
        )
        self.swaying.follow(self.image, pairs, vibration_covariance(rig))

    def _at(self, bushing: NDArray[np.float64]) -> MarkerImage:
        return self.look(swayed_skin(self._pad, self._probe, bushing))


class FreeRig:
    """Fingers on a free probe that the cruising arm shakes.

    Args:
        config: Probe, pads and vibration.
        fingers: One or two; the first is pad A.
        seeds: Of each finger's noise.
        rng: Of the vibration.
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
        """The markers at rest, one image per sensor."""
        return tuple(finger.image for finger in self._fingers)

    def stretch(
        self, steps: int
    ) -> tuple[tuple[EventPacket, ...], tuple[NDArray[np.float64], ...]]:
        """Let milliseconds pass.

        Returns:
            The events of each sensor, and its true marker centres ``(steps, m, 2)`` to first
            order, px.
        """
        bushing = self._motion.advance(steps)
        packets = tuple(finger.swaying.sway(bushing) for finger in self._fingers)
        markers = tuple(
            finger.image.center_px + np.einsum("mcf,sf->smc", finger.slopes, bushing)
            for finger in self._fingers
        )
        return packets, markers

    def windows(self, steps: int, period_us: int = 1000, sensor: int = 0) -> Iterator[EventPacket]:
        """Yield the windows of one sensor for some milliseconds."""
        chunks = (
            self.stretch(min(CHUNK_STEPS, steps - first))[0][sensor]
            for first in range(0, steps, CHUNK_STEPS)
        )
        return windows(chunks, period_us)


@functools.lru_cache(maxsize=16)
def vibration_covariance(config: RigConfig) -> NDArray[np.float64]:
    """Return the covariance ``(6, 6)`` of a free probe's bushing under the arm's vibration."""
    vibration = Vibration(config.vibration, np.random.default_rng(COVARIANCE_SEED))
    bushing = FreeMotion(config.probe, vibration).advance(COVARIANCE_STEPS)
    return bushing.T @ bushing / len(bushing)


__all__ = ["STEP_S", "FreeRig", "SmallMotionFinger", "vibration_covariance"]
