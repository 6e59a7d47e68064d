"""The manifest of a recording folder, and the names of the files beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from spikingtac.errors import RecordingError

SCHEMA = 1  # Version of the manifest that this package writes and reads.

MANIFEST, TRUTH = "manifest.json", "truth.npz"


def name_of(first: str, sensor: int) -> str:
    """Return the name of a sensor's file: ``events.raw`` of the second sensor is ``events_1.raw``.

    Args:
        first: Name of the first sensor's.
        sensor: Which one, from 0 on.
    """
    stem, dot, ending = first.rpartition(".")
    return first if sensor == 0 else f"{stem}_{sensor}{dot}{ending}"


def read_manifest(path: Path) -> dict[str, Any]:
    """Return a manifest; empty where there is none.

    Raises:
        RecordingError: It is damaged, or of a newer schema.
    """
    if not path.is_file():
        return {}
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RecordingError(f"{str(path)!r} cannot be read: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        found = manifest.get("schema") if isinstance(manifest, dict) else None
        raise RecordingError(
            f"{str(path)!r} has schema {found!r}, this version reads {SCHEMA}; "
            "update the package, or remove the manifest to read the events alone"
        )
    return manifest
