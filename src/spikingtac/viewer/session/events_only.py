"""A view of a sensor that has no calibration yet: its events, and a guide to calibrate it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.self_calibrating import SelfCalibratingDetector
from spikingtac.events.address import is_address
from spikingtac.events.evt.raw_stream import is_stream
from spikingtac.events.open import open_events
from spikingtac.events.source import EventSource
from spikingtac.sim.twin_camera import is_twin
from spikingtac.stream.host import Factory
from spikingtac.stream.remote_source import RemoteSource
from spikingtac.viewer.session.calibrating.desk import CalibrationDesk, SaveTarget
from spikingtac.viewer.session.opening import (
    NoCalibrationError,
    calibrated_view,
    open_view_source,
)
from spikingtac.viewer.session.source import ViewSource


@dataclass(frozen=True, slots=True)
class NothingToTune:
    """The settings of a view without a tracker: there are none."""


def open_view_or_events(
    source: str, *, look: bool = False, save: SaveTarget | None = None, **options: Any
) -> ViewSource:
    """Open a view; where a recording or camera has no calibration, one of its events alone.

    Args:
        source: See :func:`~spikingtac.viewer.session.opening.open_view_source`.
        look: Show the events alone even where a calibration is known, to calibrate anew.
        save: Where a calibration that the page makes goes.
        **options: As there.

    Raises:
        SpikingTacError: As there, but for a missing calibration.
    """
    if not look:
        try:
            return open_view_source(source, **options)
        except NoCalibrationError:
            pass
    live, target = is_stream(Path(source)), save or SaveTarget()
    if is_twin(source) or not (live or Path(source).exists()):
        scene = open_view_source(source, **options)  # its events; the truth shows how well it went
        return _guided(
            scene, CalibrationDesk(scene.label, scene.source.size, target, None), options
        )
    events = RemoteSource.of_camera(source, None) if live else open_events(source)
    label = source if is_address(source) else Path(source).resolve().name
    whole = None if live else Factory(function=open_whole, arguments={"path": source})
    desk = CalibrationDesk(label, events.size, target, whole)
    view = ViewSource(
        label=label,
        source=events,
        calibration=no_markers(events.size),
        config=NothingToTune(),
        make_tracker=desk.make_tracker,
        ends=not live,
        provenance={"input": label},
    )
    return _guided(view, desk, options)


def _guided(view: ViewSource, desk: CalibrationDesk, options: dict[str, Any]) -> ViewSource:
    """Return the view of the same events whose markers are not known yet."""
    preset, rate_hz = options.get("preset", "default"), options.get("rate_hz")
    contact = load_config(preset).contact
    return replace(
        view,
        calibration=no_markers(view.source.size),
        config=NothingToTune(),
        make_tracker=desk.make_tracker,
        make_detector=partial(
            SelfCalibratingDetector, contact.self_calibrating, contact.false_alarms_per_hour
        ),
        desk=desk,
        calibrated=partial(calibrated_view, preset=preset, rate_hz=rate_hz),
    )


def open_whole(path: str) -> EventSource:
    """Open a recording from its beginning."""
    return open_events(path)


def no_markers(size: tuple[int, int]) -> Calibration:
    """Return a calibration of no marker for a sensor ``(width, height)``, px."""
    return Calibration(reference_px=np.empty((0, 2)), radius_px=np.empty(0), grid=(0, 0), size=size)
