"""Trials: scene, sensor, camera and seed, and the recording and the calibration of each."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac import Calibration, calibrate
from spikingtac.atomic_files import replacing
from spikingtac.config import digest, load_config
from spikingtac.events import MANIFEST, TRUTH, open_events
from spikingtac.sim import ContactConfig, IndenterMotion, Scene, load_scene
from spikingtac.types import EventPacket
from spikingtac_paper.harness.run import code_digest
from spikingtac_paper.trials.ground_truth import GroundTruth

BOOTSTRAP_SEED = 1_000_000  # Seed of all slides: no sequence of an experiment has it.

# Camera name of the recordings that were made with v2e; they are no part of the package.
V2E = "v2e"


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
        rows, columns = load_scene(self.scene).skin.grid if self.damaged else (0, 0)
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
        from spikingtac.sim import simulate

        target = folder / "recordings" / self.recording_key()
        if not (target / MANIFEST).is_file():
            partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
            partial.mkdir(parents=True, exist_ok=True)
            simulate(self._scene(), partial, seed=self.seed, duration_s=self.duration_s)
            if not target.exists():
                partial.rename(target)
        return target

    def open(self, folder: Path, data: Path | None) -> tuple[Iterable[EventPacket], GroundTruth]:
        """Return the events and the truth.

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
        starts_s = motion.segment_starts_s[: len(before)]
        kept = [one for one, at in zip(before, starts_s, strict=True) if begun_s + at < motion_s]
        once_s = motion.duration_s + contact.pause_s
        repeats = min(contact.repeats, max(1, int((motion_s - begun_s) / once_s)))
        shorter = replace(contact.motion, segments=(*kept, release))
        yield replace(contact, motion=shorter, repeats=repeats)
        begun_s += contact.repeats * once_s


def calibration_digest(calibration: Calibration, names: tuple[str, ...] = ()) -> str:
    """Return the digest of the calibration fields that a method reads.

    Args:
        calibration: Calibration of the sensor.
        names: Names of the fields; empty means all but the provenance.
    """
    known = tuple(one.name for one in fields(calibration) if one.name != "provenance")
    values = {name: getattr(calibration, name) for name in names or known}
    return digest({name: _plain(value) for name, value in values.items()})


def _plain(value: object) -> str:
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return repr(value)


def calibration_of(trial: Trial, folder: Path, data: Path | None = None) -> Calibration:
    """Return the calibration of a trial's sensor, as a user would have made it.

    The slides are recorded with the same camera preset and the same sensor, but without damaged
    markers and extra loss. All methods use the same calibration.

    Args:
        trial: Any trial of the sensor.
        folder: Folder of the run, which holds the calibrations.
        data: Folder of recordings from elsewhere.
    """
    slides = trial.bootstrap()
    key = digest({"slides": slides.key(), "code": code_digest()})

    def recorded() -> Path:
        if trial.camera != V2E:
            return slides.record(folder)
        assert data is not None
        return data / V2E / "bootstrap.raw"

    path = folder / "calibrations" / f"{trial.camera}-{trial.serial}-{key}.json"
    return kept_calibration(path, recorded)


def kept_calibration(path: Path, recorded: Callable[[], Path]) -> Calibration:
    """Return the calibration of a file; if there is none, make it as a user would, and write it.

    Args:
        path: File of the calibration.
        recorded: Returns the recording that it is made from.
    """
    if not path.is_file():
        calibration = calibrate(open_events(recorded()), load_config("default").calibration)
        with replacing(path) as temporary:
            calibration.save(temporary)
    # Read it back: a run that continues sees the same rounded numbers as one that began.
    return Calibration.load(path)
