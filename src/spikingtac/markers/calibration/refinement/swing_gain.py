"""Whether the events of a full swing add up to a full swing.

Counts of events say what one event stands for, where each is a step of the light. Near a threshold
noise fires pairs, ON and OFF, that add up to nothing but are counted: on the twin's noisy camera
steps that explain the counts come out 13 % too small, and edges twice too wide. So the common scale
of a marker's steps is that of its full swings, wherever pixels are seen to swing fully.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.calibration.refinement.disc_corrections import RESIDUAL_LEVEL
from spikingtac.markers.calibration.refinement.expected_levels import Walk
from spikingtac.markers.calibration.refinement.offset_memory import RIM_LEVELS, OffsetMemory
from spikingtac.state_map.two_threads import divide

SENSOR_PRIOR, MARKER_PRIOR = 300.0, 50.0
"""Full swings by which counts of events are believed beforehand, for the sensor as a whole and for
each marker beside the sensor. Slides show 1,000 a marker; the recorded sensor, whose edges are so
wide that hardly a pixel swings fully, shows one a marker: such swings tell nothing."""


def swing_gain(
    seen: Walk, memory: OffsetMemory, cell: NDArray[np.int64], counted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``(m,)`` sums of real events' steps over those of ideal pixels, for full swings.

    Args:
        seen: Real and ideal pixels at the states.
        memory: Which states tell a pixel's offset.
        cell: Nearest marker of each pixel, row by row.
        counted: ``(m,)`` the same gain as the counts of events tell it: real over expected events.
    """
    product, square = _sums(seen, memory, cell, len(counted))
    usual = float(np.median(counted))
    known = square / (square + MARKER_PRIOR)
    sensor = (known @ product + SENSOR_PRIOR * usual) / (known @ square + SENSOR_PRIOR)
    beforehand = counted * (sensor / usual)
    return (product + MARKER_PRIOR * beforehand) / (square + MARKER_PRIOR)


def _sums(
    seen: Walk, memory: OffsetMemory, cell: NDArray[np.int64], markers: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Of each marker's full swings: real times ideal changes, and the squares of the ideal ones.
    states = len(seen.drawn)
    images = [image.reshape(states, -1) for image in (seen.drawn, seen.measured, seen.expected)]
    moving = np.flatnonzero((images[0] != images[0][0]).any(axis=0))

    def add_up(chosen: slice) -> NDArray[np.float64]:
        pixels = moving[chosen]
        drawn, *both = (image.take(pixels, axis=1) for image in images)
        real, ideal = memory.changes(np.array(both), drawn)
        weight = ideal / (1.0 + ((real - ideal) / RESIDUAL_LEVEL) ** 2)
        weight[(drawn > RIM_LEVELS[0]) & (drawn < RIM_LEVELS[1])] = 0.0
        sums = [(weight * change).sum(axis=0) for change in (real, ideal)]
        return np.array([np.bincount(cell[pixels], one, markers) for one in sums], float)

    product, square = np.sum(divide(len(moving), add_up), axis=0)
    return product, square
