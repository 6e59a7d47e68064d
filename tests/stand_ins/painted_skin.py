"""A skin whose pixels give exact events: discs that move and grow, no noise, no lag."""

from __future__ import annotations

import numpy as np

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.types import EventPacket

CONTRAST, EDGE_PX, STEP, RADIUS_PX = 6.0, 0.5, 0.1, 7.0
DISC = DiscProfile(CONTRAST, EDGE_PX)
PITCH_PX = 37.0


def square_calibration(side: int, pitch_px: float = PITCH_PX) -> Calibration:
    """The calibration of ``side`` by ``side`` markers, with all that growth needs."""
    axis = np.asarray(pitch_px * np.arange(side) + 0.6 * PITCH_PX, np.float64)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    pixels = int(axis[-1] + 0.6 * PITCH_PX)
    return Calibration(
        reference_px=places,
        radius_px=np.full(side**2, RADIUS_PX),
        grid=(side, side),
        size=(pixels, pixels),
        contrast=CONTRAST,
        edge_px=EDGE_PX,
        step_on=STEP,
        step_off=STEP,
        px_per_mm=pitch_px / 2.4,
    )


class PaintedSkin:
    """Pixels that give an event for each step by which they have left their last level."""

    def __init__(self, calibration: Calibration, frame_us: int) -> None:
        self._known, self._frame_us = calibration, frame_us
        self._last = self._levels(calibration.reference_px, np.zeros(len(calibration.radius_px)))
        self.t_us = 0

    def go(self, places: np.ndarray, growth: np.ndarray | float) -> EventPacket:
        """The events of a frame in which the discs go there and grow so."""
        away = self._levels(places, np.broadcast_to(growth, len(places))) - self._last
        count = np.trunc(away / STEP).astype(int)
        self._last = self._last + STEP * count
        often = np.abs(count).ravel()
        y, x = (
            np.repeat(axis.ravel(), often).astype(np.uint16) for axis in np.indices(count.shape)
        )
        start, self.t_us = self.t_us, self.t_us + self._frame_us
        on = np.repeat((count > 0).ravel(), often)
        t = np.full(len(x), start, np.int64)
        return EventPacket(x, y, on, t, start, self.t_us, self._known.size)

    def _levels(self, places: np.ndarray, growth: np.ndarray) -> np.ndarray:
        width, height = self._known.size
        rows, columns = np.mgrid[:height, :width]
        level = np.zeros((height, width))
        for (x, y), grown in zip(places, growth, strict=True):
            box = (slice(max(int(y) - 14, 0), int(y) + 15), slice(max(int(x) - 14, 0), int(x) + 15))
            away = np.hypot(columns[box] - x, rows[box] - y)
            disc = DISC.level(away - RADIUS_PX * (1.0 + grown))
            level[box] = np.maximum(level[box], disc)
        return level
