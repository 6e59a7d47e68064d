"""Open the other finger of a pair: its recording, on the first one's clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from spikingtac.errors import RecordingError
from spikingtac.events.clocks.second import is_same_folder, open_second
from spikingtac.events.manifest import name_of
from spikingtac.viewer.session.opening import (
    CALIBRATION_NAME,
    NoCalibrationError,
    open_felt_source,
    open_view_source,
)
from spikingtac.viewer.session.source import ViewSource


def open_second_view(
    *, beside: str, source: str, calibration: str | None, **options: Any
) -> ViewSource:
    """Open the other finger's recording for viewing.

    Args:
        beside: The first finger's recording.
        source: The other one's; the same folder again means its second sensor.
        calibration: Path of its calibration; calibration_1.json of one folder unless given.
        **options: As of :func:`~spikingtac.viewer.session.opening.open_view_source`.

    Raises:
        SpikingTacError: As there.
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
    opener = open_felt_source if "force" in options else open_view_source
    view = opener(source=source, calibration=calibration, **options)
    events, _ = open_second(Path(beside), path)
    if not same:
        return replace(view, source=events)
    # The truth in the folder is the first sensor's.
    return replace(view, source=events, truth=None, label=f"{view.label}, second finger")
