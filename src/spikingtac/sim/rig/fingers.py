"""Vibration of the arm, and the sensing fingers of the rig.

Vibration of the arm: a resonance driven by noise, with an exact step of any length.

The sensing fingers of the rig: optics and event camera, with the vibration of each preset.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from spikingtac.sim.camera.camera import EventCamera, ReferenceHistory
from spikingtac.sim.optics import Optics, OpticsConfig
from spikingtac.sim.scene.scene import CameraChoice
from spikingtac.sim.states import MarkerImage, SkinState
from spikingtac.types import EventPacket

# Resonance of the arm, Hz, and its Q (contract.md, "Pinned physics").
RESONANCE_HZ, QUALITY = 15.0, 5.0

# Covariance of (x, x') for unit variance of x.
STATIONARY = np.diag([1.0, (2.0 * np.pi * RESONANCE_HZ) ** 2])


class Vibration:
    """Three independent axes of x'' + (w/Q) x' + w^2 x = white noise, in their stationary state.

    The transition over a step is exact, so that the statistics do not depend on its length.

    Args:
        rms_mm: Root mean square of each axis, mm.
        rng: Source of the noise.
    """

    def __init__(self, rms_mm: float, rng: np.random.Generator) -> None:
        self._rms_mm = rms_mm
        self._rng = rng
        self._state = np.linalg.cholesky(STATIONARY) @ rng.standard_normal((2, 3))

    @property
    def offset_mm(self) -> NDArray[np.float64]:
        """Displacement ``(3,)`` of the tool now, mm."""
        return self._rms_mm * self._state[0]

    def advance(self, dt_s: float) -> NDArray[np.float64]:
        """Step by ``dt_s`` and return the new displacement ``(3,)``, mm."""
        if self._rms_mm > 0.0:
            move, noise = transition(round(dt_s * 1e9))
            self._state = move @ self._state + noise @ self._rng.standard_normal((2, 3))
        return self.offset_mm


@functools.lru_cache(maxsize=64)
def transition(dt_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the exact transition of a step ``(2, 2)`` and a root of its noise's covariance."""
    omega = 2.0 * np.pi * RESONANCE_HZ
    system = np.array([[0.0, 1.0], [-(omega**2), -omega / QUALITY]])
    whole = np.asarray(expm(system * dt_ns * 1e-9), np.float64)
    drive = STATIONARY - whole @ STATIONARY @ whole.T
    return whole, np.linalg.cholesky(drive).astype(np.float64)


# Vibration of the arm for each preset, mm rms (contract.md, "Pinned physics").
VIBRATION_MM = {"clean": 0.0, "typical": 0.01, "noisy": 0.03}

# Motion of a marker before it is rendered again, px.
#
# It is 1.5 % of a threshold at the marker's edge, and two windows at 0.8 mm/s. It saves a third
# of the computing time under vibration.
STEP_SETTINGS = {"steps": {"still_px": 0.005}}

# Edge of a disc as in the v2e recordings.
#
# Theirs is logistic with scale 0.55 px, which equals a Gaussian of 0.94 px with the square pixel
# included. The tip's travel up to the first events is proportional to it.
EDGE_SETTINGS = {"light": {"blur_px": 0.9}}


@dataclass(frozen=True, kw_only=True)
class FingerConfig:
    """One sensing finger.

    Attributes:
        camera: Preset ``clean``, ``typical`` or ``noisy``.
        settings: Tables that override parts of the preset.
        optics: Lens and discs.
        history: Initial reference levels of the pixels; see
            :meth:`~spikingtac.sim.camera.camera.EventCamera.settle`.
        serial: Number of the individual sensor. It fixes the discs, the mismatch of the pixels and
            the hot pixels.
    """

    camera: str = "typical"
    settings: dict[str, Any] = field(default_factory=lambda: EDGE_SETTINGS | STEP_SETTINGS)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    history: ReferenceHistory = "rested"
    serial: int = 1


class SensingFinger:
    """Optics and event camera of one finger.

    Args:
        config: Settings of the finger.
        seed: Seed of its noise.

    Attributes:
        optics: The lens.
        camera: The event camera.
    """

    def __init__(self, config: FingerConfig, seed: int) -> None:
        choice = CameraChoice(preset=config.camera, settings=config.settings)
        self.optics = Optics(config.optics, config.serial)
        camera = choice.resolve(config.optics.size)
        self.camera = EventCamera(camera, seed, serial=config.serial)
        self._history: ReferenceHistory = config.history

    def project(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers."""
        return self.optics.project(state)

    def settle(self, image: MarkerImage) -> None:
        """Set every pixel to its steady state under an image, with the configured history."""
        self.camera.settle(image, self._history)

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events up to the last image."""
        return self.camera.advance(images)
