"""What a tracker begins with: a map painted from the calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import Appearance, nearest_marker
from spikingtac.state_map.bands import BandStateMap
from spikingtac.state_map.graded import GradedStateMap

LAG_DEFAULT_US = 500.0
"""Delay of the events where nothing was calibrated: 150 us of latency and a 2 kHz photoreceptor's
mean time constant (the twin's preset ``typical``)."""


def painted_graded_map(calibration: Calibration, appearance: Appearance) -> GradedStateMap:
    """Return the graded map of a sensor at rest, with the calibrated steps."""
    start, step_on, step_off = _painted(calibration, appearance)
    return GradedStateMap(start, step_on, step_off, dark_markers=calibration.polarity == "dark")


def painted_band_map(calibration: Calibration, appearance: Appearance) -> BandStateMap:
    """Return the band map of a sensor at rest, with the calibrated steps."""
    start, step_on, step_off = _painted(calibration, appearance)
    return BandStateMap(start, step_on, step_off, dark_markers=calibration.polarity == "dark")


def _painted(
    calibration: Calibration, appearance: Appearance
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the levels of resting discs, and each pixel's ON and OFF step."""
    start = painted_levels(calibration, appearance, calibration.reference_px)
    owner = nearest_marker(calibration.reference_px, calibration.size)
    return (
        start,
        _steps(calibration.step_on_map, appearance.step_on[owner]),
        _steps(calibration.step_off_map, appearance.step_off[owner]),
    )


def painted_levels(
    calibration: Calibration, appearance: Appearance, center_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return ``(height, width)`` levels with the calibrated discs at ``(m, 2)`` places, px."""
    width, height = calibration.size
    levels = np.zeros((height, width), np.float32)
    for place_px, radius_px, profile in zip(
        center_px, calibration.radius_px, appearance.profiles, strict=True
    ):
        _paint_disc(levels, place_px, float(radius_px), profile)
    return levels


def _paint_disc(
    levels: np.ndarray, center_px: np.ndarray, radius_px: float, profile: DiscProfile
) -> None:
    height, width = levels.shape
    reach = radius_px + profile.reach_px
    x, y = center_px
    columns = np.arange(max(0, int(x - reach)), min(width, int(x + reach) + 2))
    rows = np.arange(max(0, int(y - reach)), min(height, int(y + reach) + 2))
    if not (columns.size and rows.size):
        return
    distance = np.hypot(columns[np.newaxis, :] - x, rows[:, np.newaxis] - y)
    patch = levels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    np.maximum(patch, profile.level(distance - radius_px), out=patch)


def _steps(step_map: NDArray[np.float32] | None, usual: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return each pixel's own step where it is known, and else that of its marker."""
    if step_map is None:
        return usual.astype(np.float32)
    return np.where(step_map > 0.0, step_map, usual).astype(np.float32)
