"""How each marker looks to the sensor: its edge, and the share of a full swing per event.

Calibrations give these for every marker where a recording taught them, for the sensor as a whole
otherwise, and a calibration that was written by hand gives neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile, disc_profiles
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.state_map.graded import STEP_DEFAULT

BLOCK_PX = 32
"""Side of the blocks in which the nearest markers are looked up, px (16 and 64 take longer)."""


@dataclass(frozen=True, slots=True)
class Appearance:
    """What is known of every marker of one sensor.

    Attributes:
        profiles: The ``m`` profiles of the discs.
        step_on: ``(m,)`` share of the full swing per ON event.
        step_off: ``(m,)`` the same per OFF event.
    """

    profiles: list[DiscProfile]
    step_on: NDArray[np.float64]
    step_off: NDArray[np.float64]


def appearance_of(calibration: Calibration) -> Appearance:
    """Return each marker's appearance: its own where it is known, else the sensor's, else usual."""
    count = len(calibration.reference_px)
    return Appearance(
        profiles=disc_profiles(calibration),
        step_on=_each(calibration.marker_step_on, calibration.step_on, count),
        step_off=_each(calibration.marker_step_off, calibration.step_off, count),
    )


def nearest_marker(reference_px: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.uint16]:
    """Return ``(height, width)`` which marker rests nearest to each pixel, the first of equals.

    Block by block, and in each only among the markers that may be nearest to one of its pixels: all
    markers at all pixels would take 3.5 s for 1,024 markers on 1280x720.
    """
    owner = np.zeros((size[1], size[0]), np.uint16)
    if not len(reference_px):
        return owner
    for top, left in product(range(0, size[1], BLOCK_PX), range(0, size[0], BLOCK_PX)):
        rows = np.arange(top, min(top + BLOCK_PX, size[1]))[:, np.newaxis]
        columns = np.arange(left, min(left + BLOCK_PX, size[0]))
        away_px = np.hypot(*(reference_px - (columns.mean(), rows.mean())).T)
        # Twice the way from a block's centre to its corner.
        near = np.flatnonzero(away_px <= away_px.min() + np.sqrt(2.0) * BLOCK_PX)
        x, y = (axis[:, np.newaxis, np.newaxis] for axis in reference_px[near].T)
        owner[rows, columns] = near[np.argmin((columns - x) ** 2 + (rows - y) ** 2, axis=0)]
    return owner


def _each(own: NDArray[np.float64] | None, common: float | None, count: int) -> NDArray[np.float64]:
    return np.full(count, common or STEP_DEFAULT) if own is None else np.asarray(own, np.float64)
