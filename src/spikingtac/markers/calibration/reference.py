"""Where markers rest without load, from where they stood whenever the sensor was silent.

The paper takes the middle of the box around all equilibrium states (section IV-D, the equation of
P_init); ``bounding-box`` is that. The default ``rest-mean`` is ours: creep after a slide leaves
each rest a little off, to the side from which it came, and slides to and fro cancel in the mean,
where a box keeps the two outermost rests of each axis alone.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError

Method = Literal["rest-mean", "bounding-box"]

NEAR_SHARE = 0.04
"""Share of the pitch within which a rest's markers stand, on the average, of the median over all
rests: 1.5 px in the paper's sensor. A hold under load is farther off."""


def unloaded(position_px: NDArray[np.float64], pitch_px: float) -> NDArray[np.bool_]:
    """Return which rests are without load: where the markers stand about where they mostly do.

    Args:
        position_px: ``(rests, m, 2)`` positions, px.
        pitch_px: Distance of neighbouring markers, px.

    Raises:
        CalibrationError: No two rests agree.
    """
    near = np.zeros(len(position_px), bool)
    if len(position_px):
        # The median of separate coordinates may lie between clusters; the medoid never does.
        between = position_px[:, np.newaxis] - position_px[np.newaxis]
        distance = np.hypot(between[..., 0], between[..., 1]).mean(axis=2)
        agreeing = (distance < 2 * NEAR_SHARE * pitch_px).sum(axis=1)
        medoid = np.lexsort((distance.mean(axis=1), -agreeing))[0]
        near = distance[medoid] < 2 * NEAR_SHARE * pitch_px
        middle = np.median(position_px[near], axis=0)
        off = position_px - middle
        near = np.hypot(off[..., 0], off[..., 1]).mean(axis=1) < NEAR_SHARE * pitch_px
    if not near.any():
        raise CalibrationError(
            "the recording holds no stretch of silence in which the markers stand still without "
            "load; lift the object off the skin for half a second between slides"
        )
    return near


def reference(position_px: NDArray[np.float64], method: Method) -> NDArray[np.float64]:
    """Return ``(m, 2)`` reference positions from ``(rests, m, 2)`` unloaded ones, px."""
    if method == "bounding-box":
        return (position_px.min(axis=0) + position_px.max(axis=0)) / 2.0
    return position_px.mean(axis=0)


def mean_pitch_px(position_px: NDArray[np.float64], shape: tuple[int, int]) -> float:
    """Return the mean distance of neighbours in rows and columns, px; infinite for one marker."""
    cells = position_px.reshape(*shape, 2)
    steps = [np.diff(cells, axis=axis).reshape(-1, 2) for axis in (0, 1)]
    length = np.hypot(*np.concatenate(steps).T)
    return float(length.mean()) if len(length) else np.inf
