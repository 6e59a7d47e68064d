"""Records of markers that move, without a tracker."""

import numpy as np

from spikingtac.markers.graded.motion import resting_markers


def moving_markers(
    position_px: np.ndarray, velocity_px_s: np.ndarray | float = 0.0, t_us: int = 0
) -> np.ndarray:
    """Return records of markers at positions, with velocities, at a time."""
    markers = resting_markers(position_px)
    markers["vx"], markers["vy"] = np.broadcast_to(velocity_px_s, position_px.shape).T
    markers["t_us"] = t_us
    return markers
