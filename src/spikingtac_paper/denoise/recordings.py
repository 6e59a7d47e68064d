"""Clean recordings for the ``denoise`` experiment, with their truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.open import open_events
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.scene import CameraChoice, Scene
from spikingtac.sim.scene.source import SceneSource
from spikingtac.types import EventPacket
from spikingtac_paper.denoise.scoring import CleanRecording

QUIET = CameraChoice(
    preset="typical",
    settings={
        "background": {"rate_hz": 0.0, "hot_fraction": 0.0},
        "pixel": {"leak_hz": 0.0},
    },
)
"""The typical camera without its noise."""


@dataclass(frozen=True, slots=True)
class TrueRecording:
    """A clean recording with its true marker positions.

    Attributes:
        clean: The recording.
        t_us: ``(n,)`` times of the truth, us.
        marker_px: ``(n, m, 2)`` true centres, px.
    """

    clean: CleanRecording
    t_us: NDArray[np.int64]
    marker_px: NDArray[np.float32]

    def at(self, t_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the true centres ``(k, m, 2)`` at some times, px; each is that of the next row."""
        rows = np.minimum(np.searchsorted(self.t_us, t_us), len(self.t_us) - 1)
        return self.marker_px[rows].astype(np.float64)


def noise_free(scene: Scene) -> Scene:
    """Return the scene with the typical camera, without its noise."""
    return replace(scene, camera=QUIET)


def render(scene_name: str, seed: int, duration_s: float) -> TrueRecording:
    """Render one recording of the twin without noise, with its truth."""
    source = SceneSource(noise_free(catalog.load(scene_name)), seed, duration_s)
    steps = list(source.steps())
    events = EventPacket.concatenate([step.packet for step in steps])
    clean = CleanRecording(scene_name, events, source.reference_px, source.radius_px, "twin")
    times = np.concatenate([step.truth.marker_t_us for step in steps])
    return TrueRecording(clean, times, np.concatenate([step.truth.marker_px for step in steps]))


def open_v2e(folder: str | Path, name: str = "mix") -> TrueRecording:
    """Open a v2e recording; its own noise (0.1 Hz/px) remains in it."""
    source = open_events(Path(folder) / f"{name}.raw")
    events = EventPacket.concatenate([packet for packet in source if len(packet)])
    with np.load(Path(folder) / f"{name}.truth.npz", allow_pickle=False) as truth:
        clean = CleanRecording(
            name, events, truth["reference_px"].astype(float), truth["radius_px"].astype(float),
            "v2e",
        )  # fmt: skip
        return TrueRecording(clean, truth["marker_t_us"], truth["marker_px"])
