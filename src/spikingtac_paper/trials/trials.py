"""Trials: scene, sensor, camera and seed, and the recording of each."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.config import digest
from spikingtac.events.filters import RandomDrop
from spikingtac.events.manifest import MANIFEST, TRUTH
from spikingtac.events.open import open_events
from spikingtac.sim.scene import catalog
from spikingtac.types import EventPacket
from spikingtac_paper.harness.fingerprint import code_digest
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.shortened_scenes import shortened

BOOTSTRAP_SEED = 1_000_000
"""Seed of all slides: no sequence of an experiment has it."""

V2E = "v2e"
"""Camera name of the recordings that were made with v2e; they are no part of the package."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One recording with known truth.

    Attributes:
        case: Case of the report, with the camera as a prefix, as in ``noisy/loops``.
        scene: Scene of the catalogue; for :data:`V2E` the name of the recording.
        seed: Seed of the scene's variation and of the camera's noise.
        serial: Serial number of the sensor specimen.
        camera: Preset of the camera, or :data:`V2E`.
        settings: Camera settings that replace those of the preset.
        loss: Fraction of the events that is dropped at random, besides the camera's own losses.
        damaged: Number of markers that are damaged after the calibration: alternately missing and
            cut in half.
        groups: Other cases to which the trial contributes.
        duration_s: Length, s; None is the scene's own.
        motion_s: Motions that begin later are left out, s; None keeps all.
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
        """Indices of the damaged markers; the seed draws them."""
        rows, columns = catalog.load(self.scene).skin.grid if self.damaged else (0, 0)
        drawn = np.random.default_rng([self.seed, self.damaged]).permutation(rows * columns)
        return tuple(int(marker) for marker in drawn[: self.damaged])

    def bootstrap(self) -> Trial:
        """Return the trial of the slides that calibrate this sensor, without extra loss.

        Their noise is another than that of any sequence: from equal seeds it would be the same
        events, and a calibration would know them.
        """
        return replace(
            self,
            case="bootstrap",
            scene="bootstrap",
            seed=BOOTSTRAP_SEED,
            loss=0.0,
            damaged=0,
            groups=(),
            duration_s=None,
            motion_s=None,
        )

    def recording_key(self) -> str:
        """Return the name of the recording's folder; equal names mean equal events."""
        about = {
            "scene": self._scene().resolved(),
            "seed": self.seed,
            "duration_s": self.duration_s or 0.0,
            "simulator": code_digest(),
        }
        return f"{self.scene}-{self.camera}-{self.serial}-{self.seed}-{digest(about)}"

    def key(self) -> str:
        """Return the digest of everything on which the events of the trial depend."""
        if self.camera == V2E:
            return digest({"recording": f"{V2E}/{self.scene}"})
        return digest({"recording": self.recording_key(), "loss": self.loss, "seed": self.seed})

    def record(self, folder: Path) -> Path:
        """Return the folder of the recording; simulate it first if it does not exist."""
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
        """Return the events, which can be iterated repeatedly, and the truth.

        Args:
            folder: Folder of the run, which holds the recordings.
            data: Folder of recordings from elsewhere, for :data:`V2E`.
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
    """A recording that loses a fraction of its events, the same ones at each reading.

    Attributes:
        packets: The recording.
        fraction: Fraction of the events that is lost.
        seed: Seed of the selection.
    """

    packets: Iterable[EventPacket]
    fraction: float
    seed: int

    def __iter__(self) -> Iterator[EventPacket]:
        drop = RandomDrop(self.fraction, self.seed)
        return (drop(packet) for packet in self.packets)
