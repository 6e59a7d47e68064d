"""Trials: scenes of the twin and files from elsewhere, and the calibration of each sensor."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import Calibration, calibrate
from spikingtac.atomic_files import replacing
from spikingtac.config import digest
from spikingtac.events import MANIFEST, TRUTH, open_events
from spikingtac.sim import ContactConfig, IndenterMotion, Scene, load_scene, simulate
from spikingtac.types import EventPacket
from spikingtac_paper.harness.run import code_digest
from spikingtac_paper.trials.trajectories import GroundTruth

BOOTSTRAP_SEED = 1_000_000  # Seed of all slides: no sequence of an experiment has it.

# Folder of the recordings that were made with v2e; they are no part of the package.
V2E = "v2e"


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One recording with known truth.

    Attributes:
        case: Case of the report, with the camera as a prefix, as in ``noisy/loops``.
        scene: Scene of the catalogue.
        seed: Seed of the scene's variation and of the camera's noise.
        serial: Serial number of the sensor specimen.
        camera: Preset of the camera.
        settings: Camera settings that replace those of the preset.
        loss: Fraction of the events that is dropped at random, besides the camera's own losses.
        damaged: Number of markers that are damaged after the calibration: alternately missing and
            cut in half.
        groups: Other cases to which the trial contributes.
        duration_s: Length, s; None is the scene's own.
        motion_s: Motions that begin later are left out, s; None keeps all.
        source: ``twin``.
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
        rows, columns = load_scene(self.scene).skin.grid if self.damaged else (0, 0)
        drawn = np.random.default_rng([self.seed, self.damaged]).permutation(rows * columns)
        return tuple(int(marker) for marker in drawn[: self.damaged])

    def bootstrap(self) -> Trial:
        """Return the trial of the slides that calibrate this sensor, without extra loss.

        Their noise is another than that of any sequence: from equal seeds it would be the same
        events, and a calibration would know them.
        """
        return Trial(
            case="bootstrap",
            scene="bootstrap",
            seed=BOOTSTRAP_SEED,
            serial=self.serial,
            camera=self.camera,
            settings=self.settings,
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
        return digest({"recording": self.recording_key(), "loss": self.loss, "seed": self.seed})

    def calibration_path(self, folder: Path) -> Path:
        """Return the file of the sensor's calibration in the folder of a run."""
        key = digest({"slides": self.bootstrap().key(), "code": code_digest()})
        return folder / "calibrations" / f"{self.camera}-{self.serial}-{key}.json"

    def slides(self, folder: Path, data: Path | None) -> Path:
        """Return the recording that the sensor is calibrated from."""
        del data
        return self.bootstrap().record(folder)

    def record(self, folder: Path) -> Path:
        """Return the folder of the recording; simulate it first if it does not exist."""
        target = folder / "recordings" / self.recording_key()
        if not (target / MANIFEST).is_file():
            partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
            partial.mkdir(parents=True, exist_ok=True)
            simulate(self._scene(), partial, seed=self.seed, duration_s=self.duration_s)
            if not target.exists():
                partial.rename(target)
        return target

    def open(
        self, folder: Path, data: Path | None = None
    ) -> tuple[Iterable[EventPacket], GroundTruth]:
        """Return the events and the truth, from the folder of a run."""
        del data
        target = self.record(folder)
        events: Iterable[EventPacket] = open_events(target)
        if self.loss:
            rng, source = np.random.default_rng(self.seed), open_events(target)
            events = (part.select(rng.random(len(part)) >= self.loss) for part in source)
        return events, GroundTruth.load(target / TRUTH)

    def _scene(self) -> Any:
        scene = load_scene(self.scene).with_camera(self.camera).with_serial(self.serial)
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


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedTrial:
    """A recording from elsewhere, and one way to calibrate its sensor.

    Files are named from the folder of recordings on.

    Attributes:
        case: Case of the report.
        events: File to track.
        slides_from: File to calibrate from; None calibrates from :attr:`events` itself.
        reference: File with the true course of the markers, or with their standing places.
        source: ``simulated`` (a transparent model), ``v2e`` or ``recorded``.
        groups: Other cases to which the trial contributes.
        seed: There is one recording only.
    """

    case: str
    events: str
    slides_from: str | None = None
    reference: str
    source: str
    groups: tuple[str, ...] = ()
    seed: int = 0

    def is_there(self, data: Path | None) -> bool:
        """Return whether all files are in the folder of recordings."""
        named = (self.events, self.slides_from or self.events, self.reference)
        return data is not None and all((data / name).is_file() for name in named)

    def key(self) -> str:
        """Return the digest of everything on which the events of the trial depend."""
        return digest({"recording": self.events})

    def calibration_path(self, folder: Path) -> Path:
        """Return the file of the sensor's calibration in the folder of a run."""
        name = (self.slides_from or self.events).replace("/", "-")
        return folder / "calibrations" / f"{name}-{code_digest()}.json"

    def slides(self, folder: Path, data: Path | None) -> Path:
        """Return the recording that the sensor is calibrated from."""
        del folder
        assert data is not None
        return data / (self.slides_from or self.events)

    def open(self, folder: Path, data: Path | None = None) -> tuple[Iterable[EventPacket], Path]:
        """Return the events, and the file with the truth or the standing places."""
        del folder
        assert data is not None
        return open_events(data / self.events), data / self.reference


def shortened(scene: Scene, motion_s: float) -> Scene:
    """Return the scene with the motions of the first ``motion_s`` seconds, then the release.

    The rest before the first contact and after the last one stays whole, so that every metric keeps
    its meaning.

    Args:
        scene: A scene of the catalogue.
        motion_s: Motions that begin later are left out, s.
    """
    return replace(scene, contacts=tuple(_first(scene.contacts, motion_s)))


def _first(contacts: tuple[ContactConfig, ...], motion_s: float) -> Iterator[ContactConfig]:
    begun_s = 0.0
    for contact in contacts:
        if begun_s >= motion_s:
            return
        motion = IndenterMotion(contact.motion)
        *before, release = contact.motion.segments
        starts_s = motion.starts_s[: len(before)]
        kept = [one for one, at in zip(before, starts_s, strict=True) if begun_s + at < motion_s]
        once_s = motion.duration_s + contact.pause_s
        repeats = min(contact.repeats, max(1, int((motion_s - begun_s) / once_s)))
        shorter = replace(contact.motion, segments=(*kept, release))
        yield replace(contact, motion=shorter, repeats=repeats)
        begun_s += contact.repeats * once_s


def calibration_of(
    trial: Trial | RecordedTrial, folder: Path, data: Path | None = None
) -> Calibration:
    """Return the calibration of a trial's sensor, made as a user would if there is none yet.

    The slides are recorded with the same camera preset and the same sensor, but without damaged
    markers and extra loss. All methods use the same calibration.

    Args:
        trial: Any trial of the sensor.
        folder: Folder of the run, which holds the calibrations.
        data: Folder of recordings from elsewhere.
    """
    path = trial.calibration_path(folder)
    if not path.is_file():
        slides = open_events(trial.slides(folder, data))
        calibration = calibrate(slides)
        with replacing(path) as temporary:
            calibration.save(temporary)
    # Read it back: a run that continues sees the same rounded numbers as one that began.
    return Calibration.load(path)
