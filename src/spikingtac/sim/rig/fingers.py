"""The fingers of the rig as pinned: optics, an event camera, and vibration that fits its preset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError, nearest
from spikingtac.sim.camera.camera import EventCamera, TrackerHistory
from spikingtac.sim.optics.projection import Optics, OpticsConfig
from spikingtac.sim.optics.states import MarkerImage, SkinState
from spikingtac.sim.rig.rig import Rig, RigConfig
from spikingtac.sim.rig.walls import Wall
from spikingtac.sim.scene.scene import CameraChoice
from spikingtac.types import EventPacket

VIBRATION_MM = {"clean": 0.0, "typical": 0.01, "noisy": 0.03}
"""Vibration of the arm by preset, mm rms (contract.md, "Pinned physics")."""

FINGERS = 2
STEPS = {"steps": {"still_px": 0.005}}
"""How far a marker moves before it is rendered again, px: 1.5 % of a threshold at its edge, and two
windows at 0.8 mm/s. It saves a third of the time under vibration."""
EDGE = {"light": {"blur_px": 0.9}}
"""Edge of a disc as in the v2e recordings: logistic of 0.55 px, a Gaussian of 0.94 px with the
pixel's box. The tip's travel to the first events is proportional to it."""


@dataclass(frozen=True, kw_only=True)
class FingerConfig:
    """One sensing finger.

    Attributes:
        camera: Preset ``clean``, ``typical`` or ``noisy``.
        settings: Tables laid over the preset.
        optics: The lens and the discs.
        history: The pixels' references before anything moves; see :class:`EventCamera`.
        serial: Which specimen: its discs, its pixels' mismatch, its hot pixels.
    """

    camera: str = "typical"
    settings: dict[str, Any] = field(default_factory=lambda: EDGE | STEPS)
    optics: OpticsConfig = field(default_factory=OpticsConfig)
    history: TrackerHistory = "rested"
    serial: int = 1


class SensingFinger:
    """Optics and event camera of one finger.

    Args:
        config: What it is.
        seed: Of its noise.

    Attributes:
        optics: The lens.
        camera: The event camera.
    """

    def __init__(self, config: FingerConfig, seed: int) -> None:
        choice = CameraChoice(preset=config.camera, settings=config.settings)
        self.optics = Optics(config.optics, config.serial)
        camera = choice.resolve(config.optics.size)
        self.camera = EventCamera(camera, seed, serial=config.serial)
        self._history: TrackerHistory = config.history

    def look(self, state: SkinState) -> MarkerImage:
        """Return the image of the markers."""
        return self.optics.project(state)

    def settle(self, image: MarkerImage) -> None:
        """Let every pixel come to rest under an image, with the configured history."""
        self.camera.settle(image, self._history)

    def advance(self, images: Sequence[MarkerImage]) -> EventPacket:
        """Return the events up to the last image."""
        return self.camera.advance(images)


def pinned_rig(
    preset: str, wall: Wall, start_mm: Sequence[float], seed: int, config: RigConfig | None = None
) -> Rig:
    """Return the rig of contract.md's "Pinned physics": two fingers, and the preset's vibration.

    Args:
        preset: ``clean``, ``typical`` or ``noisy``.
        wall: What the tip can touch.
        start_mm: Where the arm holds the tip at first, base frame, mm.
        seed: Of everything random.
        config: Probe, pads and arm; its vibration is replaced by the preset's.

    Raises:
        ConfigError: The preset is unknown.
    """
    if preset not in VIBRATION_MM:
        raise ConfigError(
            f"no preset {preset!r}{nearest(preset, VIBRATION_MM)} "
            f"(valid: {', '.join(VIBRATION_MM)})"
        )
    base = config or RigConfig()
    shaking = replace(base.vibration, rms_mm=VIBRATION_MM[preset])
    serial = base.pad.skin.serial
    fingers = [
        SensingFinger(FingerConfig(camera=preset, serial=serial + k), FINGERS * seed + k)
        for k in range(FINGERS)
    ]
    rng = np.random.default_rng(seed)
    whole = replace(base, vibration=shaking)
    return Rig(whole, wall, fingers, np.array(start_mm, np.float64), rng)
