"""Render a scene into a recording folder with events, truth and manifest."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.atomic_files import whole_folder
from spikingtac.errors import ConfigError
from spikingtac.events.recording import MANIFEST, RecordingWriter
from spikingtac.sim.scene import Scene
from spikingtac.sim.source import SceneSource

LENGTH_S = (1e-3, 1e5)  # Valid lengths of a recording, s: up to a day.


def simulate(
    scene: Scene,
    folder: str | Path,
    *,
    seed: int = 0,
    duration_s: float | None = None,
    overwrite: bool = False,
    advance: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Render a scene into a recording folder. Equal seeds give equal files.

    Memory does not grow with the scene. After an error or an interrupt the files are removed.

    Args:
        scene: The scene.
        folder: Folder to write: ``events.raw`` (EVT3), ``truth.npz``, ``manifest.json``.
        seed: Seed of the variations and of the camera's noise.
        duration_s: Length, s; None is the scene's own length.
        overwrite: Write also into a folder that holds files; those of a recording are replaced.
        advance: Receives the completed fraction, 0 to 1.

    Returns:
        Folder, duration, numbers of events and markers, and the digest of the scene.

    Raises:
        ConfigError: No scene, a seed or duration out of range, or a folder that holds files.
        OSError: The folder cannot be written.
    """
    if seed < 0:
        raise ConfigError(f"seed is {seed}, it must not be negative")
    low, high = LENGTH_S
    if duration_s is not None and not low <= duration_s <= high:
        raise ConfigError(f"duration_s is {duration_s:g}, valid are {low:g} to {high:g} s")
    target = _prepared(Path(folder), overwrite)
    source, events = SceneSource(scene, seed, duration_s), 0
    with (
        whole_folder(target, last=MANIFEST) as partial,
        RecordingWriter(partial, source.size) as writer,
    ):
        for name in ("reference_px", "reference_mm", "cell_axis_mm", "radius_px"):
            writer.truth_file().set(name, getattr(source, name).astype(np.float32))
        for step in source.steps():
            writer.write(step.packet)
            writer.truth_file().append(step.truth._asdict())
            events += len(step.packet)
            if advance is not None and source.t_end_us:
                advance(step.packet.t_end_us / source.t_end_us)
        writer.losses.update(source.losses)
        told = source.manifest()
        span = {"t_start_us": 0, "t_end_us": source.t_end_us, "events": events}
        writer.describe(**told, **span, scene=scene.resolved())
    return {
        "folder": str(target),
        "duration_s": (source.t_end_us or 0) / 1e6,
        "events": events,
        "markers": len(source.reference_px),
        "scene_sha256": told["scene_sha256"],
    }


def _prepared(folder: Path, overwrite: bool) -> Path:
    held = sorted(folder.iterdir()) if folder.exists() else []
    if held and not overwrite:
        raise ConfigError(
            f"the folder {str(folder)!r} holds {held[0].name!r}; choose an empty or a new folder, "
            "or give --overwrite to write into this one"
        )
    return folder
