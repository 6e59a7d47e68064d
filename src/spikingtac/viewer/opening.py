"""Open what a user names: an event file, a recording folder, a camera, or a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.document import CALIBRATION_SCHEMA
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.registry import SelfCalibratingDetector
from spikingtac.errors import CalibrationError, ConfigError, RecordingError
from spikingtac.events.address import Address, is_address, is_stream
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.events.manifest import MANIFEST, TRUTH, is_same_folder, name_of, read_manifest
from spikingtac.events.open import open_events, open_second, refuse_url
from spikingtac.events.source import EventSource
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.track import require_same_size
from spikingtac.sim.twin_camera import is_twin, twin_options
from spikingtac.stream.reader import LiveSource, opened_camera
from spikingtac.stream.sources import RemoteSource
from spikingtac.touch.force.model import load_force
from spikingtac.viewer.calibrating import CalibrationDesk, NothingToTune, SaveTarget
from spikingtac.viewer.felt import FeltLayer
from spikingtac.viewer.source import SampledTruth, ViewSource

CALIBRATION_NAME = "calibration.json"


class NoCalibrationError(CalibrationError):
    """No calibration was named, and none lies beside the recording."""


def open_view_source(
    source: str,
    *,
    calibration: str | None = None,
    preset: str = "default",
    rate_hz: float | None = None,
    force: str | None = None,
    **scene: Any,
) -> ViewSource:
    """Open an event file, a recording folder, a camera, or a scene of the digital twin.

    Args:
        source: Path, address of a camera, or name of a scene.
        calibration: Path of a calibration; a folder's own unless given; a scene brings its own.
        preset: Configuration: ``default``, ``fast``, ``paper``, or a TOML file.
        rate_hz: Estimates per second; the preset's unless given.
        force: Path of a force model, to show what is felt.
        **scene: ``seed`` and ``camera`` (a preset) of a scene.

    Raises:
        RecordingError: The recording cannot be read.
        DeviceError: There is no such camera.
        CalibrationError: The calibration does not fit; NoCalibrationError where there is none.
        ConfigError: There is neither such a path nor such a scene, a recording has a camera, or
            the force model cannot be read or is of another sensor.
    """
    path, named = Path(source), (scene.get("seed", 0), scene.get("camera"))
    if is_twin(source):  # the page shows the truth that the twin knows
        address = Address.parse(source)
        view = _open_scene(address.target, *twin_options(address, *named))
    elif is_stream(path):
        if calibration is None:
            raise NoCalibrationError(f"{source!r} is a camera; name its --calibration")
        events = LiveSource.of(opened_camera(source, Calibration.load(calibration).size))
        view = _events_alone(path.name, events, ends=False)
    elif path.suffix == ".toml" or not path.exists():
        refuse_url(path)
        if path.suffix != ".toml" and (path.suffix or len(path.parts) > 1):
            raise RecordingError(
                f"there is no file or folder {source!r}; a scene is named without an ending "
                "(spikingtac simulate --list)"
            )
        view = _open_scene(source, *named)
    elif scene.get("camera") is not None:
        raise ConfigError(f"{source!r} is a recording, --camera belongs to a scene; leave it out")
    else:
        view = _open_recording(path, calibration)
    if calibration is not None:
        given = Calibration.load(calibration)
        view = replace(view, calibration=given, calibrated_by=calibration, own_calibration=False)
    require_same_size(view.source.size, view.calibration.size)
    view = calibrated_view(view, view.calibration, preset=preset, rate_hz=rate_hz)
    if force is not None:
        layer = FeltLayer(view.calibration.reference_px, view.rate_hz, load_force(force))
        view = replace(view, felt=layer)
    return view


def calibrated_view(
    view: ViewSource, calibration: Calibration, *, preset: str, rate_hz: float | None
) -> ViewSource:
    """Return a view whose markers are tracked by a preset.

    Args:
        view: The events.
        calibration: Of their sensor.
        preset: As of :func:`open_view_source`, and so is ``rate_hz``.
        rate_hz: Estimates per second.
    """
    settings = load_config(preset).with_tracking(rate_hz=rate_hz)
    return replace(
        view,
        calibration=calibration,
        own_calibration=view.own_calibration and calibration is view.calibration,
        config=settings.tracking,
        make_tracker=partial(make_tracker, calibration=calibration),
        make_detector=partial(SelfCalibratingDetector, settings.contact.false_alarms_per_hour),
        rate_hz=settings.tracking.rate_hz,
    )


def open_view_or_events(
    source: str, *, look: bool = False, save: SaveTarget | None = None, **options: Any
) -> ViewSource:
    """Open a view; where a recording or camera has no calibration, one of its events alone.

    Args:
        source: See :func:`open_view_source`.
        look: Show the events alone even where a calibration is known, to calibrate anew.
        save: Where a calibration that the page makes goes.
        **options: As there; forces are shown of a calibrated sensor only.
    """
    if not look:
        try:
            return open_view_source(source, **options)
        except NoCalibrationError:
            if options.get("force") is not None:
                raise
    live = is_stream(Path(source))
    whole: Callable[[], EventSource] | None = None
    if is_twin(source) or not (live or Path(source).exists()):
        view = open_view_source(source, **options)  # its events; the truth shows how well it went
    else:
        events = LiveSource.of(opened_camera(source, None)) if live else open_events(source)
        label = source if is_address(source) else Path(source).resolve().name
        view = _events_alone(label, events, ends=not live)
        if not live:
            whole = partial(open_events, path=source)
    preset = options.get("preset", "default")
    calibrated = partial(calibrated_view, preset=preset, rate_hz=options.get("rate_hz"))
    desk = CalibrationDesk(view.label, view.source.size, save or SaveTarget(), whole, calibrated)
    return replace(
        calibrated(view, _events_alone(view.label, view.source).calibration),
        calibrated_by="",
        config=NothingToTune(),
        make_tracker=lambda _: desk.tracker,
        rate_hz=view.rate_hz,
        desk=desk,
    )


def open_second_view(
    *, beside: str, source: str, calibration: str | None, **options: Any
) -> ViewSource:
    """Open the other finger's recording for viewing.

    Args:
        beside: The first finger's recording.
        source: The other one's; the same folder again means its second sensor.
        calibration: Path of its calibration; calibration_1.json of one folder unless given.
        **options: As of :func:`open_view_source`.
    """
    path, same = Path(source), is_same_folder(Path(beside), Path(source))
    if same and not (path / name_of("events.raw", 1)).is_file():
        raise RecordingError(f"{source!r} holds one sensor; name the other finger's recording")
    if same and calibration is None:
        own = path / name_of(CALIBRATION_NAME, 1)
        if not own.is_file():
            raise NoCalibrationError(
                f"{source!r} holds no {own.name}; name the other finger's: --second-calibration"
            )
        calibration = str(own)
    view = open_view_source(source, calibration=calibration, **options)
    events, _ = open_second(Path(beside), path)
    if not same:
        return replace(view, source=events)
    # The truth in the folder is the first sensor's.
    return replace(view, source=events, truth=None, label=f"{view.label}, second finger")


def _events_alone(label: str, events: EventSource, *, ends: bool = True) -> ViewSource:
    """Return a view of events without markers; its tracker is not chosen yet."""
    none, size = np.empty((0, 2)), events.size
    calibration = Calibration(reference_px=none, radius_px=none[:, 0], grid=(0, 0), size=size)
    return ViewSource(
        label=label,
        source=events,
        calibration=calibration,
        config=None,
        make_tracker=partial(make_tracker, calibration=calibration),
        ends=ends,
    )


def _open_recording(path: Path, calibration: str | None) -> ViewSource:
    source = open_events(path)  # first: a file that is no recording needs no calibration
    folder = path if path.is_dir() else path.parent
    manifest = read_manifest(folder / MANIFEST) if path.is_dir() else {}
    stored = folder / TRUTH if path.is_dir() else path.with_suffix(".truth.npz")
    known = load_arrays(stored, "ground truth") if stored.exists() else {}
    if known and not {"marker_t_us", "marker_px"} <= known.keys():
        raise RecordingError(
            f"{str(stored)!r} lacks marker_t_us or marker_px; remove it, or simulate the scene "
            "again"
        )
    view = replace(
        _events_alone(path.resolve().name, source),
        truth=SampledTruth(known["marker_t_us"].tolist(), known["marker_px"]) if known else None,
        simulated=manifest.get("source") == "twin",
    )
    beside = folder / CALIBRATION_NAME
    if calibration is not None:
        return view
    if beside.exists():
        return replace(view, calibration=Calibration.load(beside), calibrated_by=str(beside))
    if "grid" in manifest and known:
        document = {
            "schema": CALIBRATION_SCHEMA,
            **{name: manifest.get(name) for name in ("size", "grid")},
            **{name: known.get(name) for name in ("reference_px", "radius_px")},
            "polarity": _polarity(manifest.get("contrast")),
            "provenance": {"from": "the twin's truth at rest"},
        }
        found = Calibration.from_document(document, where=str(stored))
        return replace(view, calibration=found, calibrated_by="the twin's truth at rest")
    raise NoCalibrationError(
        f"there is no {CALIBRATION_NAME} beside the recording; name one with --calibration, or "
        "make it with: spikingtac calibrate RECORDING -o calibration.json"
    )


def _open_scene(name: str, seed: int, camera: str | None) -> ViewSource:
    from spikingtac.sim import catalog
    from spikingtac.sim.source import SceneSource
    from spikingtac.sim.twin_camera import truthful_packets

    scene = catalog.load_scene(name).with_camera(camera)
    at_rest, truth = SceneSource(scene, seed), SampledTruth()
    arguments = {"name": name, "seed": seed, "camera": camera}
    packets = RemoteSource(
        partial(truthful_packets, **arguments),
        scene.size,
        lambda rows: truth.append(*rows),
    )
    return replace(
        _events_alone(Path(name).stem, packets, ends=False),
        calibration=Calibration(
            reference_px=at_rest.reference_px,
            radius_px=at_rest.radius_px,
            grid=scene.skin.grid,
            size=scene.size,
            polarity=_polarity(scene.camera.resolve(scene.size).light.contrast),
            provenance={"from": f"the scene {name!r} at rest"},
        ),
        calibrated_by="the scene at rest",
        truth=truth,
        simulated=True,
        own_calibration=True,
    )


def _polarity(contrast: Any) -> str:
    """Return which markers a scene has; one of unknown contrast (marker over ground) has white."""
    return "dark" if isinstance(contrast, int | float) and contrast < 1 else "white"
