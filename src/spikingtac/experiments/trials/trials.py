"""Trials: which scene, which sensor, which camera, which seed; and the recording behind each."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.config import digest
from spikingtac.events.filters import RandomDrop
from spikingtac.events.open import open_events
from spikingtac.events.recording import MANIFEST, TRUTH
from spikingtac.experiments.harness.fingerprint import SIMULATOR, code_digest, modules_behind
from spikingtac.experiments.trials.ground_truth import GroundTruth
from spikingtac.experiments.trials.shortened_scenes import shortened
from spikingtac.sim.scene import catalog
from spikingtac.types import EventPacket

V2E = "v2e"
"""Camera name of the recordings made with v2e, which lie outside of the package."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One recording with known truth.

    Attributes:
        case: Row of the report, the camera as a prefix, as in ``noisy/loops``.
        scene: Scene of the catalogue; the name of the recording for :data:`V2E`.
        seed: Of the scene's variation and of the camera's noise.
        serial: Which sensor of the series.
        camera: Preset of the camera, or :data:`V2E`.
        settings: Camera tables laid over the preset.
        loss: Share of the events that is dropped at random, on top of the camera's own losses.
        damaged: How many markers are damaged after the calibration: in turn gone and cut in half.
        groups: Other rows that the trial counts towards.
        duration_s: Length, s; None is the scene's own.
        motion_s: Motions that begin later than this are left out, s; None keeps all.
        source: ``twin``, ``v2e`` or ``recorded``.
    """

    case: str
    scene: str
    seed: int = 0
    serial: int = 1
    camera: str = "typical"
    settings: dict[str, Any] = field(default_factory=dict)
    loss: float = 0.0
    damaged: int = 0
    groups: tuple[str, ...] = ()
    duration_s: float | None = None
    motion_s: float | None = None
    source: str = "twin"

    @property
    def damaged_markers(self) -> tuple[int, ...]:
        """Which markers are damaged: drawn by the seed, so that another seed has others."""
        rows, columns = catalog.load(self.scene).skin.grid if self.damaged else (0, 0)
        drawn = np.random.default_rng([self.seed, self.damaged]).permutation(rows * columns)
        return tuple(int(marker) for marker in drawn[: self.damaged])

    def bootstrap(self) -> Trial:
        """Return the slides that calibrate this trial's sensor: the same camera, nothing lost."""
        return replace(
            self,
            case="bootstrap",
            scene="bootstrap",
            seed=0,
            loss=0.0,
            damaged=0,
            groups=(),
            duration_s=None,
            motion_s=None,
        )

    def recording_key(self) -> str:
        """Return the name of the recording's folder: equal names hold equal events."""
        about = {
            "scene": self._scene().resolved(),
            "seed": self.seed,
            "duration_s": self.duration_s or 0.0,
            "simulator": code_digest(modules_behind(SIMULATOR, within="sim")),
        }
        return f"{self.scene}-{self.camera}-{self.serial}-{self.seed}-{digest(about)}"

    def key(self) -> str:
        """Return the digest of everything that decides the events a method sees."""
        if self.camera == V2E:
            return digest({"recording": f"{V2E}/{self.scene}"})
        return digest({"recording": self.recording_key(), "loss": self.loss, "seed": self.seed})

    def record(self, folder: Path) -> Path:
        """Return the recording's folder; simulate it first where it is not there."""
        from spikingtac.sim.scene.render import simulate

        target = folder / "recordings" / self.recording_key()
        if not (target / MANIFEST).is_file():
            partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
            partial.mkdir(parents=True, exist_ok=True)
            simulate(self._scene(), partial, seed=self.seed, duration_s=self.duration_s)
            if not target.exists():
                partial.rename(target)
        return target

    def open(self, folder: Path, data: Path | None) -> tuple[Iterable[EventPacket], GroundTruth]:
        """Return the events (which can be read again and again) and the truth.

        Args:
            folder: Where recordings are kept.
            data: Folder of foreign recordings, for :data:`V2E`.
        """
        if self.camera == V2E:
            assert data is not None
            raw = data / V2E / f"{self.scene}.raw"
            return open_events(raw), GroundTruth.load(raw.with_suffix(".truth.npz"))
        target = self.record(folder)
        events: Iterable[EventPacket] = open_events(target)
        if self.loss:
            events = Dropped(events, self.loss, self.seed)
        return events, GroundTruth.load(target / TRUTH)

    def _scene(self) -> Any:
        scene = catalog.load(self.scene).with_camera(self.camera).with_serial(self.serial)
        if self.motion_s is not None:
            scene = shortened(scene, self.motion_s)
        if self.settings:
            camera = replace(scene.camera, settings={**scene.camera.settings, **self.settings})
            scene = replace(scene, camera=camera)
        if self.damaged:
            markers = self.damaged_markers
            discs = replace(scene.optics.discs, missing=markers[::2], broken=markers[1::2])
            scene = replace(scene, optics=replace(scene.optics, discs=discs))
        return scene


@dataclass(frozen=True, slots=True)
class Dropped:
    """A recording of which a share of the events is lost, the same ones at each reading."""

    packets: Iterable[EventPacket]
    share: float
    seed: int

    def __iter__(self) -> Iterator[EventPacket]:
        drop = RandomDrop(self.share, self.seed)
        return (drop(packet) for packet in self.packets)
