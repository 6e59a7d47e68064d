"""A view of a recording that has no calibration yet: its events, and figures of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.quality import judge_events
from spikingtac.live.event_store import EventStore
from spikingtac.types import EventPacket, MarkerFrame

LONGEST_US = 20_000_000
"""Stretch of a recording that is judged, us: its first 20 s, so that a long one opens at once."""


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


def quality_of(store: EventStore) -> dict[str, Any]:
    """Return the figures of a recording's events, for the page."""
    end_us = min(store.t_end_us, store.t_start_us + LONGEST_US)
    found = judge_events(store.between(store.t_start_us, end_us))
    return {
        "rate_hz": round(found.rate_hz, 1),
        "on_fraction": None if found.on_fraction is None else round(found.on_fraction, 4),
        "noise_hz": round(found.noise_hz, 4),
        "hot_pixels": len(found.hot_px),
    }
