"""A scene as a recording folder: events, truth and manifest, the same bytes for the same seed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.create import create_events
from spikingtac.sim.scene import Scene
from spikingtac.sim.source import SceneSource
from spikingtac.sim.truth import TruthChunk

MANIFEST_SCHEMA = 1
EVENTS_NAME, TRUTH_NAME, MANIFEST_NAME = "events.raw", "truth.npz", "manifest.json"


def simulate(
    scene: Scene,
    folder: str | Path,
    *,
    seed: int = 0,
    duration_s: float | None = None,
    overwrite: bool = False,
    advance: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Render a scene into a recording folder.

    Events are written as they come; the truth (0.5 MB/s) is kept until the end. A folder that is
    cut short by an error or an interrupt is left without the files.

    Args:
        scene: What happens.
        folder: Folder to write: ``events.raw`` (EVT3), ``truth.npz``, ``manifest.json``.
        seed: Of the variations and of the camera's noise.
        duration_s: Length; None is the scene's own.
        overwrite: Write also into a folder that holds something else than a simulation.
        advance: Is told the share that is done, 0 to 1.

    Returns:
        Folder, duration, and numbers of events and markers, for whoever reports them.

    Raises:
        ConfigError: The seed or the duration is out of range, or the folder holds something else.
        RecordingError: The folder cannot be written.
    """
    if seed < 0:
        raise ConfigError(f"seed is {seed}, it must not be negative")
    if duration_s is not None and not 0 < duration_s < math.inf:
        raise ConfigError(f"duration_s is {duration_s}, it must be positive and finite")
    target = _prepared(Path(folder), overwrite)
    source = SceneSource(scene, seed, duration_s)
    try:
        events, truth = _write_events(source, target / EVENTS_NAME, advance)
        _write_truth(source, truth, target / TRUTH_NAME)
        document = json.dumps(manifest(source, events), indent=1, sort_keys=True)
        (target / MANIFEST_NAME).write_text(document + "\n", encoding="utf-8")
    except BaseException:
        for name in (EVENTS_NAME, TRUTH_NAME, MANIFEST_NAME):
            (target / name).unlink(missing_ok=True)
        raise
    assert source.t_end_us is not None
    return {
        "folder": str(target),
        "duration_s": source.t_end_us / 1e6,
        "events": events,
        "markers": len(source.reference_px),
        "scene_sha256": scene.digest(),
    }


def manifest(source: SceneSource, events: int) -> dict[str, Any]:
    """Return the manifest of a finished simulation; nothing in it depends on when or where."""
    scene = source.scene
    camera = scene.camera.resolve(scene.size)
    return {
        "schema": MANIFEST_SCHEMA,
        "source": "twin",
        "package_version": version("spikingtac"),
        "size": list(source.size),
        "grid": list(scene.skin.grid),
        "t_start_us": 0,
        "t_end_us": source.t_end_us,
        "events": events,
        "seed": source.seed,
        "contrast": camera.light.contrast,
        "threshold_on": camera.pixel.threshold_on,
        "threshold_off": camera.pixel.threshold_off,
        "losses": dict(source.losses.kinds()),
        "scene": scene.resolved(),
        "scene_sha256": scene.digest(),
    }


def _prepared(folder: Path, overwrite: bool) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        raise RecordingError(
            f"cannot write the folder {str(folder)!r}: {error.strerror}"
        ) from error
    if held and not overwrite and not _is_simulation(folder):
        raise ConfigError(
            f"the folder {str(folder)!r} holds {held[0]!r} and is no simulation; "
            "choose an empty or a new one, or give --overwrite to write into it"
        )
    return folder


def _is_simulation(folder: Path) -> bool:
    try:
        document = json.loads((folder / MANIFEST_NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("source") == "twin"


def _write_events(
    source: SceneSource, path: Path, advance: Callable[[float], None] | None
) -> tuple[int, TruthChunk]:
    chunks: list[TruthChunk] = []
    events = 0
    with create_events(path, source.size) as writer:
        for step in source.steps():
            writer.write(step.packet)
            chunks.append(step.truth)
            events += len(step.packet)
            if advance is not None and source.t_end_us:
                advance(step.packet.t_end_us / source.t_end_us)
    return events, TruthChunk.concatenate(chunks)


def _write_truth(source: SceneSource, truth: TruthChunk, path: Path) -> None:
    np.savez(
        path,
        marker_t_us=truth.marker_t_us,
        marker_px=truth.marker_px,
        reference_px=source.reference_px.astype(np.float32),
        radius_px=source.radius_px.astype(np.float32),
        contact_t_us=truth.contact_t_us,
        force_n=truth.force_n,
        pose_mm=truth.pose_mm,
        in_contact=truth.in_contact,
    )
