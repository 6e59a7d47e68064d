"""The manifest of a recording that grows: written at its beginning, at every file, at its end."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from spikingtac._version import package_version
from spikingtac.atomic_files import write_text
from spikingtac.cameras.recording.segments import Part
from spikingtac.events.manifest import MANIFEST, SCHEMA, name_of

RESERVE = ".reserve"
RESERVE_BYTES = 1 << 18
"""Space that is kept for the last manifest of a disk that runs full: one of 1,000 files fits."""


class ManifestFile:
    """Writes ``manifest.json``, whole each time, also when the disk is full.

    Args:
        folder: Of the recording.
        size: ``(width, height)`` of the sensor, px.
        sensor: Which sensor of the folder, from 0 on.
    """

    def __init__(self, folder: Path, size: tuple[int, int], sensor: int = 0) -> None:
        self._path = folder / name_of(MANIFEST, sensor)
        self._reserve = folder / f"{RESERVE}{sensor or ''}"
        self._size = size
        self._started = time.time()
        # Real bytes: a sparse file reserves nothing.
        self._reserve.write_bytes(os.urandom(RESERVE_BYTES))

    def write(self, fields: Mapping[str, Any], about: Mapping[str, Any]) -> None:
        """Write the manifest.

        Args:
            fields: Of the recorder: ``complete``, ``parts``, ``gaps_lost``, ``lost_events``,
                ``failure``.
            about: Of the camera, as it stands.

        Raises:
            OSError: There is no room even for this.
        """
        parts: list[Part] = list(fields["parts"])
        document = {
            "schema": SCHEMA,
            "source": "camera",
            "complete": fields["complete"],
            "failure": fields["failure"],
            "size": list(self._size),
            "sensors": 1,
            "t_start_us": parts[0].t_first_us if parts else 0,
            "t_end_us": parts[-1].t_last_us + 1 if parts and parts[-1].events else 0,
            "events": sum(part.events for part in parts),
            "lost_events": fields["lost_events"],
            "lost": [
                {"t_from_us": first, "t_to_us": last, "events": events}
                for first, last, events in fields["gaps_lost"]
            ],
            "files": [asdict(part) for part in parts],
            "started_unix_s": round(self._started, 6),
            "written_unix_s": round(time.time(), 6),
            "package_version": package_version(),
            "host": host(),
            **about,
        }
        text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
        try:
            write_text(self._path, text)
        except OSError:
            self.close()  # makes room
            write_text(self._path, text)

    def close(self) -> None:
        """Give the reserved space back."""
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)


def host() -> dict[str, Any]:
    """Return what the machine and its clocks are; no name of a machine or a person."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "processors": os.cpu_count(),
        # The clock of the mapping starts with the machine: this turns it into the time of day.
        "unix_minus_monotonic_s": time.time() - time.monotonic(),
    }
