"""Open what a user names: an event file, a recording folder, a camera's pipe, or a scene."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spikingtac.calibration.document import CALIBRATION_SCHEMA
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.event_count import SelfCalibratingDetector
from spikingtac.errors import CalibrationError, ConfigError, RecordingError
from spikingtac.events.address import Address
from spikingtac.events.evt.raw_stream import is_stream
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.events.open import refuse_url
from spikingtac.markers.registry import make_tracker
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.sim.twin_camera import is_twin, twin_options
from spikingtac.stream.host import Factory
from spikingtac.stream.sources import LiveSource, RemoteSource
from spikingtac.viewer.source import SampledTruth, ViewSource

CALIBRATION_NAME, TRUTH_NAME, MANIFEST_NAME = "calibration.json", "truth.npz", "manifest.json"


class NoCalibrationError(CalibrationError):
    """No calibration was named, and none lies beside the recording."""


def open_view_source(
    source: str,
    *,
    calibration: str | None = None,
    preset: str = "default",
    rate_hz: float | None = None,
    seed: int = 0,
    camera: str | None = None,
) -> ViewSource:
    """Open an event file, a recording folder, a camera, or a scene of the digital twin.

    Args:
        source: Path, address of a camera, or name of a scene.
        calibration: Path of a calibration; a folder's own unless given; a scene brings its own.
        preset: Configuration: ``default``, ``fast``, ``paper``, or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
        seed: Of a scene.
        camera: Camera preset of a scene.

    Raises:
        RecordingError: The recording cannot be read.
        DeviceError: There is no such camera.
        NoCalibrationError: There is no calibration for it.
        CalibrationError: The calibration does not fit.
        ConfigError: There is neither such a path nor such a scene, or a recording was given a
            camera.
    """
    path = Path(source)
    if is_twin(source):
        view = _open_twin(source, seed, camera)
    elif is_stream(path):
        view = _open_stream(path, calibration)
    elif path.suffix == ".toml" or not path.exists():
        _refuse_missing_file(path)
        view = _open_scene(source, seed, camera)
    elif camera is not None:
        raise ConfigError(
            f"{source!r} is a recording, and --camera belongs to a scene; leave it out"
        )
    else:
        view = _open_recording(path, calibration)
    if calibration is not None:
        given = Calibration.load(calibration)
        view = replace(view, calibration=given, calibrated_by=calibration, own_calibration=False)
    if tuple(view.calibration.size) != tuple(view.source.size):
        from spikingtac.pipeline.track import require_same_size

        require_same_size(view.source.size, view.calibration.size)
    return calibrated_view(view, view.calibration, preset=preset, rate_hz=rate_hz)


def calibrated_view(
    view: ViewSource, calibration: Calibration, *, preset: str, rate_hz: float | None
) -> ViewSource:
    """Return a view whose markers are tracked by a preset.

    Args:
        view: The events.
        calibration: Of their sensor.
        preset: Configuration: ``default``, ``fast``, ``paper``, or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
    """
    settings = load_config(preset).with_tracking(rate_hz=rate_hz)
    config, contact = settings.tracking, settings.contact
    return replace(
        view,
        calibration=calibration,
        own_calibration=view.own_calibration and calibration is view.calibration,
        config=config,
        make_tracker=partial(_tracker, calibration),
        make_detector=partial(SelfCalibratingDetector, contact.false_alarms_per_hour),
        rate_hz=config.rate_hz,
    )


def open_felt_source(*, force: str, **arguments: Any) -> ViewSource:
    """Open a source and show what is felt: :func:`open_view_source` with a force model's path.

    Raises:
        ConfigError: The force model cannot be read, or is of another sensor; and as there.
    """
    from spikingtac.touch.force.model import load_force
    from spikingtac.viewer.felt import FeltLayer

    model = load_force(force)
    view = open_view_source(**arguments)
    felt = FeltLayer(view.calibration.reference_px, view.rate_hz, model)
    return replace(view, felt=felt)


def _refuse_missing_file(path: Path) -> None:
    """Say so where a file was meant; the list of scenes would not help."""
    refuse_url(path)
    if path.suffix != ".toml" and (path.suffix or len(path.parts) > 1):
        raise RecordingError(
            f"there is no file or folder {str(path)!r}; "
            "a scene is named without an ending (spikingtac simulate --list)"
        )


def _tracker(calibration: Calibration, config: TrackingConfig) -> MarkerTracker:
    return make_tracker(config, calibration)


def _open_recording(path: Path, calibration: str | None) -> ViewSource:
    from spikingtac.events.open import open_events

    source = open_events(path)  # first: a file that is no recording needs no calibration
    folder = path if path.is_dir() else path.parent
    truth_path = folder / TRUTH_NAME if path.is_dir() else path.with_suffix(".truth.npz")
    manifest = _manifest(folder) if path.is_dir() else {}
    chosen, by = (
        (Calibration.load(calibration), calibration) if calibration else _beside(folder, manifest)
    )
    return ViewSource(
        label=path.resolve().name,
        source=source,
        calibration=chosen,
        calibrated_by=by,
        config=None,
        make_tracker=_unchosen,
        truth=_truth(truth_path),
        simulated=manifest.get("source") == "twin",
        provenance={"input": path.name},
    )


def _open_stream(path: Path, calibration: str | None) -> ViewSource:
    if calibration is None:
        raise NoCalibrationError(f"{str(path)!r} is a camera; name its --calibration")
    chosen = Calibration.load(calibration)
    return ViewSource(
        label=path.name,
        source=LiveSource.in_process(str(path), chosen.size),
        calibration=chosen,
        config=None,
        make_tracker=_unchosen,
        ends=False,
        provenance={"input": path.name},
    )


def _open_twin(source: str, seed: int, camera: str | None) -> ViewSource:
    """Open the scene of a twin's address: the page shows the truth that the twin knows."""
    address = Address.parse(source)
    return _open_scene(address.target, *twin_options(address, seed, camera))


def _open_scene(name: str, seed: int, camera: str | None) -> ViewSource:
    from spikingtac.sim.scene import catalog
    from spikingtac.sim.scene.source import SceneSource
    from spikingtac.sim.twin_camera import truthful_packets

    scene = catalog.load(name).with_camera(camera)
    at_rest = SceneSource(scene, seed)
    contrast = scene.camera.resolve(scene.size).light.contrast
    truth = SampledTruth.growing(len(at_rest.reference_px))
    arguments = {"name": name, "seed": seed, "camera": camera}
    return ViewSource(
        label=Path(name).stem,
        source=RemoteSource(
            Factory(function=truthful_packets, arguments=arguments),
            scene.size,
            lambda rows: truth.append(rows[0], rows[1]),
            inherit=True,
        ),
        calibration=Calibration(
            reference_px=at_rest.reference_px,
            radius_px=at_rest.radius_px,
            grid=scene.skin.grid,
            size=scene.size,
            polarity="dark" if contrast < 1 else "white",
            provenance={"from": f"the scene {name!r} at rest"},
        ),
        calibrated_by="the scene at rest",
        config=None,
        make_tracker=_unchosen,
        truth=truth,
        simulated=True,
        ends=False,
        provenance={"scene": name, "seed": seed, "scene_sha256": scene.digest()},
        own_calibration=True,
    )


def _manifest(folder: Path) -> dict[str, Any]:
    try:
        document = json.loads((folder / MANIFEST_NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def _beside(folder: Path, manifest: dict[str, Any]) -> tuple[Calibration, str]:
    """Return the calibration beside a recording, and what it is."""
    if (folder / CALIBRATION_NAME).exists():
        found = folder / CALIBRATION_NAME
        return Calibration.load(found), str(found)
    if "grid" in manifest and (folder / TRUTH_NAME).exists():
        return _calibration_from_truth(folder / TRUTH_NAME, manifest), "the twin's truth at rest"
    raise NoCalibrationError(
        f"there is no {CALIBRATION_NAME} beside the recording; name one with --calibration, or "
        "make it with: spikingtac calibrate RECORDING -o calibration.json"
    )


def _calibration_from_truth(path: Path, manifest: dict[str, Any]) -> Calibration:
    stored = load_arrays(path, "ground truth")
    contrast = manifest.get("contrast")
    document = {
        "schema": CALIBRATION_SCHEMA,
        "size": manifest.get("size"),
        "grid": manifest.get("grid"),
        "reference_px": stored.get("reference_px"),
        "radius_px": stored.get("radius_px"),
        "polarity": "dark" if isinstance(contrast, int | float) and contrast < 1 else "white",
        "provenance": {"from": "the twin's truth at rest"},
    }
    return Calibration.from_document(document, where=str(path))


def _truth(path: Path) -> SampledTruth | None:
    if not path.exists():
        return None
    stored = load_arrays(path, "ground truth")
    if not {"marker_t_us", "marker_px"} <= stored.keys():
        raise RecordingError(
            f"{str(path)!r} lacks marker_t_us or marker_px; remove it, or simulate the scene again"
        )
    return SampledTruth(stored["marker_t_us"], stored["marker_px"])


def _unchosen(_: Any) -> Any:
    raise ConfigError("no tracker was chosen")
