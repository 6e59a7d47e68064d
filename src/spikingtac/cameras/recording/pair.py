"""Two cameras into one folder, each on its own clock, with the map between the two beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_text
from spikingtac.cameras.recording.session import Progress, RecordOptions, record
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.clocks.time_map import through_host
from spikingtac.events.manifest import MANIFEST, name_of, read_manifest

TIME_BASE = "time_base"
"""Key of the second manifest: the map from its clock to the first sensor's."""


def record_pair(
    sources: Sequence[CameraSource],
    folder: Path,
    options: RecordOptions,
    show: Callable[[Sequence[Progress]], object] = lambda progress: None,
) -> dict[str, Any]:
    """Record two cameras until both have ended, are closed, or the time is up.

    Args:
        sources: The two cameras.
        folder: An existing folder, see :mod:`spikingtac.cameras.recording.session`.
        options: How to record both; the live copy is of the first one.
        show: Told how both stand, a few times a second.

    Returns:
        The summary of the first one, with ``second``, that of the other, and ``time_base``, the map
        from the second clock to the first (None where a camera delivered nothing).
    """
    first, second = sources
    latest: dict[int, Progress] = {}

    def shown(sensor: int, progress: Progress) -> None:
        latest[sensor] = progress
        if sensor == 0:
            show([latest[key] for key in sorted(latest)])

    of_first = replace(options, sensors=len(sources))
    of_second = replace(of_first, sensor=1, copy=None)
    with ThreadPoolExecutor(1, "spikingtac-second-camera") as pool:
        other = pool.submit(record, second, folder, of_second, partial(shown, 1))
        try:
            summary = record(first, folder, of_first, partial(shown, 0))
        except BaseException:
            second.close()
            raise
        told = other.result()
    return {**summary, "second": told, TIME_BASE: _noted(folder, first, second)}


def _noted(folder: Path, first: CameraSource, second: CameraSource) -> dict[str, Any] | None:
    """Write the map between the clocks into the second manifest, and return it."""
    base, own = first.clock.mapping(), second.clock.mapping()
    if base is None or own is None:
        return None
    found = through_host(own, base).summary()
    path = folder / name_of(MANIFEST, 1)
    document = {**read_manifest(path), TIME_BASE: found}
    write_text(path, json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n")
    return found
