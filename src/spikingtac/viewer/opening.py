"""Open what a user names: an event file, a recording folder, a camera, or a scene."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.document import CALIBRATION_SCHEMA
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.registry import SelfCalibratingDetector
from spikingtac.errors import CalibrationError, RecordingError, nearest
from spikingtac.events.camera import Address, is_address, is_stream
from spikingtac.events.formats.array_file import load_truth
from spikingtac.events.open import open_events
from spikingtac.events.recording import MANIFEST, TRUTH, read_manifest
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.track import require_same_size
from spikingtac.sim import catalog
from spikingtac.sim.twin_camera import RemoteSource, is_twin, truthful_packets, twin_options
from spikingtac.stream.reader import open_live
from spikingtac.touch.force.model import load_force
from spikingtac.viewer.calibrating import CalibrationDesk, NothingToTune, SaveTarget
from spikingtac.viewer.source import FeltLayer, SampledTruth, ViewSource

CALIBRATION_NAME = "calibration.json"
Fields = dict[str, Any]  # Attributes of a :class:`ViewSource`, and its calibration where known.


def open_view(
    source: str,
    *,
    calibration: str | None = None,
    preset: str = "default",
    rate_hz: float | None = None,
    force: str | None = None,
    **more: Any,
) -> ViewSource:
    """Open an event file, a recording folder, a camera, or a scene of the digital twin.

    Args:
        source: Path, address of a camera, or name of a scene.
        calibration: Path of a calibration; a folder's own unless given; a scene brings its own.
        preset: Configuration: ``default``, ``fast``, ``paper``, or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
        force: Path of a force model, to show what is felt.
        **more: ``seed`` and ``camera`` (a preset) of a scene; and ``save``, a :class:`SaveTarget`,
            where events without a calibration are shown alone, to be calibrated with the page.

    Raises:
        RecordingError: The recording cannot be read.
        DeviceError: There is no such camera.
        CalibrationError: The calibration does not fit, or there is none.
        ConfigError: There is neither such a path nor such a scene, or the force model cannot be
            read or is of another sensor.
    """
    save: SaveTarget | None = more.get("save")
    anew = save is not None and save.anew
    # The events, and the calibration: the named one, or the one that they bring.
    found = _events(source, own=calibration is None and not anew, **more)
    known = found.pop("calibration", None)
    if calibration is not None:
        known = Calibration.load(calibration)
        found |= {"calibrated_by": calibration, "own_calibration": False}
    # Without one, events alone, to be calibrated with the page.
    tracked_by = partial(_tracked_by, preset=preset, rate_hz=rate_hz)
    if save is not None and (anew or (known is None and force is None)):
        return _to_calibrate(source, found, tracked_by, save)
    if known is None:
        raise CalibrationError(
            f"{source!r} has no calibration, and no {CALIBRATION_NAME} lies beside it; name one "
            "with --calibration, or make it with: spikingtac calibrate RECORDING -o "
            f"{CALIBRATION_NAME}"
        )
    require_same_size(found["source"].size, known.size)
    view = ViewSource(**found, **tracked_by(known))
    if force is None:
        return view
    return replace(view, felt=FeltLayer(known.reference_px, view.rate_hz, load_force(force)))


def _tracked_by(calibration: Calibration, *, preset: str, rate_hz: float | None) -> Fields:
    """Return the attributes of a view whose markers are tracked by a preset."""
    settings = load_config(preset).with_tracking(rate_hz=rate_hz)
    return {
        "calibration": calibration,
        "config": settings.tracking,
        "make_tracker": partial(make_tracker, calibration=calibration),
        "make_detector": partial(SelfCalibratingDetector, settings.contact.false_alarms_per_hour),
        "rate_hz": settings.tracking.rate_hz,
    }


def _to_calibrate(source: str, found: Fields, tracked_by: Any, save: SaveTarget) -> ViewSource:
    """Return a view of events alone; the truth of a scene shows how well calibrating went."""
    none, size = np.empty((0, 2)), found["source"].size
    empty = Calibration(reference_px=none, radius_px=none[:, 0], grid=(0, 0), size=size)
    whole = partial(open_events, path=source)
    desk = CalibrationDesk(
        found["label"], size, save, whole if found.get("ends", True) else None, tracked_by
    )
    alone: Fields = {
        "config": NothingToTune(),
        "make_tracker": lambda _: desk.tracker,
        "rate_hz": 1_000.0,
    }
    alone |= {"desk": desk, "calibrated_by": "", "own_calibration": False}
    return ViewSource(**{**found, **tracked_by(empty), **alone})


def _events(
    source: str, *, own: bool, seed: int = 0, camera: str | None = None, **_: Any
) -> Fields:
    """Open the events; ``own`` asks for the calibration that a recording brings."""
    path = Path(source)
    if is_twin(source):  # the page shows the truth that the twin knows
        address = Address.parse(source)
        return _scene(address.target, *twin_options(address, seed, camera))
    if is_stream(path):
        label = source if is_address(source) else path.resolve().name
        return {"label": label, "source": open_live(source), "ends": False}
    if is_scene(source):
        if path.suffix != ".toml" and source not in (scenes := catalog.scene_names()):
            raise RecordingError(
                f"there is no file or folder {source!r}, and no scene of that name"
                f"{nearest(source, scenes)} (spikingtac simulate --list)"
            )
        return _scene(source, seed, camera)
    return _recording(path, own)


def is_scene(source: str) -> bool:
    """Return whether a source is a scene of the twin: its name, its file, or its address."""
    path = Path(source)
    return is_twin(source) or not (is_stream(path) or (path.exists() and path.suffix != ".toml"))


def _recording(path: Path, own: bool) -> Fields:
    source = open_events(path)  # first: a file that is no recording needs no calibration
    folder = path if path.is_dir() else path.parent
    manifest = read_manifest(folder / MANIFEST) if path.is_dir() else {}
    stored = folder / TRUTH if path.is_dir() else path.with_suffix(".truth.npz")
    known = load_truth(stored) if stored.exists() else {}
    found: Fields = {
        "label": path.resolve().name,
        "source": source,
        "truth": SampledTruth(known["marker_t_us"].tolist(), known["marker_px"]) if known else None,
        "simulated": manifest.get("source") == "twin",
    }
    beside = folder / CALIBRATION_NAME
    if own and beside.exists():
        found |= {"calibration": Calibration.load(beside), "calibrated_by": str(beside)}
    elif own and known and "grid" in manifest:
        places = {name: known.get(name) for name in ("reference_px", "radius_px")}
        stated = places | {name: manifest.get(name) for name in ("size", "grid", "contrast")}
        found |= _calibrated("the twin's truth at rest", str(stored), **stated)
    return found


def _scene(name: str, seed: int, camera: str | None) -> Fields:
    from spikingtac.sim.source import SceneSource

    scene = catalog.load_scene(name).with_camera(camera)
    at_rest, truth = SceneSource(scene, seed), SampledTruth()
    opened = partial(truthful_packets, name=name, seed=seed, camera=camera)
    calibrated = _calibrated(
        "the scene at rest",
        name,
        size=scene.size,
        grid=scene.skin.grid,
        contrast=scene.camera.resolve().light.contrast,
        reference_px=at_rest.reference_px,
        radius_px=at_rest.radius_px,
    )
    return {
        **calibrated,
        "label": Path(name).stem,
        "source": RemoteSource(opened, scene.size, lambda rows: truth.append(*rows)),
        "ends": False,
        "truth": truth,
        "simulated": True,
        "own_calibration": True,
    }


def _calibrated(told: str, where: str, *, contrast: Any, **known: Any) -> Fields:
    """Return the calibration that a simulation knows; markers of unknown contrast are white."""
    dark = isinstance(contrast, int | float) and contrast < 1
    known |= {"polarity": "dark" if dark else "white", "provenance": {"from": told}}
    document = {"schema": CALIBRATION_SCHEMA, **known}
    return {"calibration": Calibration.from_document(document, where=where), "calibrated_by": told}
