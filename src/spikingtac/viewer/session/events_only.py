"""A view of a recording that has no calibration yet: its events, and figures of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.self_calibrating import SelfCalibratingDetector
from spikingtac.events.cameras.source import CameraSource
from spikingtac.events.formats.evt.raw_stream import is_stream
from spikingtac.events.open import open_events
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.session.opening import NoCalibrationError, open_view_source
from spikingtac.viewer.session.source import ViewSource


@dataclass(frozen=True, slots=True)
class NothingToTune:
    """The settings of a view without a tracker: there are none."""


class NoTracker:
    """The tracker of a sensor whose markers are not known: it follows none of them."""

    def absorb(self, packet: EventPacket) -> None:
        """Do nothing with the events."""

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return an estimate of no marker."""
        places = np.empty((0, 2))
        return MarkerFrame(
            t_us=t_us,
            detected_px=places,
            position_px=places,
            displacement_px=places,
            coasted=np.empty(0, bool),
            confidence=np.empty(0),
        )

    def reset(self) -> None:
        """Do nothing: there is no past."""


def open_view_or_events(source: str, **options: Any) -> ViewSource:
    """Open a view; where a recording or camera has no calibration, one of its events alone.

    Args:
        source: See :func:`~spikingtac.viewer.session.opening.open_view_source`.
        **options: The same.

    Raises:
        SpikingTacError: As there, but for a missing calibration.
    """
    try:
        return open_view_source(source, **options)
    except NoCalibrationError:
        events = open_events(source)
    if isinstance(events, CameraSource):
        events.when_lost = "reconnect"
    contact = load_config(options.get("preset", "default")).contact
    return ViewSource(
        label=Path(source).resolve().name,
        source=events,
        calibration=no_markers(events.size),
        config=NothingToTune(),
        make_tracker=_no_tracker,
        make_detector=partial(
            SelfCalibratingDetector, contact.self_calibrating, contact.false_alarms_per_hour
        ),
        notice=advice(source if is_stream(Path(source)) else Path(source).name),
        ends=not is_stream(Path(source)),
        provenance={"input": Path(source).name},
    )


def _no_tracker(_: Any) -> NoTracker:
    return NoTracker()


def no_markers(size: tuple[int, int]) -> Calibration:
    """Return a calibration of no marker for a sensor ``(width, height)``, px."""
    return Calibration(reference_px=np.empty((0, 2)), radius_px=np.empty(0), grid=(0, 0), size=size)


def advice(recording: str) -> str:
    """Return what to do about a missing calibration."""
    return (
        "There is no calibration: the page shows events only. To see the markers, run: "
        f"spikingtac calibrate {recording} -o calibration.json, and view again with "
        "--calibration calibration.json"
    )
