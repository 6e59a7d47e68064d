"""The sensing fingers of the rig: optics and event camera, with the vibration of each preset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from spikingtac.sim.camera.camera import EventCamera, ReferenceHistory
from spikingtac.sim.optics import Optics, OpticsConfig
from spikingtac.sim.scene.scene import CameraChoice
from spikingtac.sim.states import MarkerImage, SkinState
from spikingtac.types import EventPacket

VIBRATION_MM = {"clean": 0.0, "typical": 0.01, "noisy": 0.03}
"""Vibration of the arm for each preset, mm rms (contract.md, "Pinned physics")."""

STEP_SETTINGS = {"steps": {"still_px": 0.005}}
"""Motion of a marker before it is rendered again, px.

It is 1.5 % of a threshold at the marker's edge, and two windows at 0.8 mm/s. It saves a third of
the computing time under vibration.
"""
EDGE_SETTINGS = {"light": {"blur_px": 0.9}}
"""Edge of a disc as in the v2e recordings.

Theirs is logistic with scale 0.55 px, which equals a Gaussian of 0.94 px with the square pixel
included. The tip's travel up to the first events is proportional to it.
"""


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
