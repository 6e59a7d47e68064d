"""Ablation of the hold: a tracker without positions for markers that are not observed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import EventPacket, MarkerFrame


class NoHold:
    """Outputs the rest position for each marker that coasts or is predicted."""

    def __init__(self, tracker: MarkerTracker, calibration: Calibration) -> None:
        """Wrap a tracker; its own state does not change.

        Args:
            tracker: Any tracker.
            calibration: The calibration, with the rest positions.
        """
        self._tracker, self._rest_px = tracker, calibration.reference_px

    def absorb(self, packet: EventPacket) -> None:
        """Pass the events on."""
        self._tracker.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the tracker's frame with unobserved markers at rest."""
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
