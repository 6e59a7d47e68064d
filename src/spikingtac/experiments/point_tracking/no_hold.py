"""What the hold is worth: a tracker that forgets a marker as soon as it is not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import EventPacket, MarkerFrame


class NoHold:
    """Gives out each marker that is coasted or predicted at its place of rest instead."""

    def __init__(self, tracker: MarkerTracker, calibration: Calibration) -> None:
        """Wrap a tracker, whose own state is left as it is.

        Args:
            tracker: Any.
            calibration: Where the markers rest.
        """
        self._tracker, self._rest_px = tracker, calibration.reference_px

    def absorb(self, packet: EventPacket) -> None:
        """Pass the events on."""
        self._tracker.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the tracker's frame without what it only remembers."""
        frame = self._tracker.estimate(t_us)
        coasted = frame.coasted[:, None]
        detected_px = np.where(coasted, self._rest_px, frame.detected_px)
        position_px = np.where(coasted, self._rest_px, frame.position_px)
        return replace(
            frame,
            detected_px=detected_px,
            position_px=position_px,
            displacement_px=position_px - self._rest_px,
        )

    def reset(self) -> None:
        """Reset the tracker."""
        self._tracker.reset()
