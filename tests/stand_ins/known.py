"""Calibrations of sensors whose markers are known, and records of markers that move."""

import math
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.motion import resting_markers


def known(
    reference_px: np.ndarray,
    radius_px: np.ndarray | float = 7.0,
    size: tuple[int, int] = (320, 320),
    grid: tuple[int, int] | None = None,
    step: float | None = None,
    **more: Any,
) -> Calibration:
    """Return the calibration of markers at these places, a square of them unless a grid is given.

    Args:
        reference_px: ``(m, 2)`` places, px.
        radius_px: Radius of each marker or of all, px.
        size: ``(width, height)``, px.
        grid: Rows and columns.
        step: ``step_on`` and ``step_off``.
        more: Other fields.
    """
    places = np.array(reference_px, np.float64)
    radii = np.broadcast_to(np.float64(radius_px), len(places)).copy()
    side = math.isqrt(len(places))
    grid = grid or ((side, side) if side * side == len(places) else None)
    more = {"step_on": step, "step_off": step} | more
    return Calibration(reference_px=places, radius_px=radii, grid=grid, size=size, **more)


def moving_markers(
    position_px: np.ndarray, velocity_px_s: np.ndarray | float = 0.0, t_us: int = 0
) -> np.ndarray:
    """Return records of markers at positions, with velocities, at a time."""
    markers = resting_markers(position_px)
    markers["vx"], markers["vy"] = np.broadcast_to(velocity_px_s, position_px.shape).T
    markers["t_us"] = t_us
    return markers
