"""Levels less each pixel's own offset, which is not known and drifts.

Where a pixel's level stood when the recording began cannot be told, so that only its changes from
state to state count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

RIM_LEVELS = (0.03, 0.97)  # Between these levels a pixel lies on a rim.


@dataclass(frozen=True, slots=True)
class OffsetMemory:
    """Which states determine the offset of a pixel's level; it drifts by noise and wrong steps.

    Attributes:
        states: The offset is a mean over so many states around (exponential weights).
        rim_weight: What a state counts while the pixel lies on a rim, where the offset cannot be
            told from the place.
    """

    states: float
    rim_weight: float

    def changes(
        self, levels: NDArray[np.float32], drawn: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return levels less each pixel's mean over the states around.

        Args:
            levels: ``(fields, states, pixels)`` levels, or derivatives of them.
            drawn: ``(states, pixels)`` levels that the discs show.
        """
        out = levels.copy()
        remove_offsets_kernel(out, drawn, self.states, self.rim_weight)
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def remove_offsets_kernel(
    fields: NDArray[np.float32],
    drawn: NDArray[np.float32],
    offset_states: float,
    rim_weight: float,
) -> None:
    """Take each pixel's mean over the states around off its fields.

    Fields are ``(fields, states, pixels)``, ``drawn`` is ``(states, pixels)``. The mean has
    exponential weights to both sides, which fall to 1 / e over ``offset_states``; states at which
    the pixel lies on a rim weigh ``rim_weight``. The weights are those of all fields.
    """
    keep, on_rim = np.float32(np.exp(-1.0 / offset_states)), np.float32(rim_weight)
    low, high, one = np.float32(RIM_LEVELS[0]), np.float32(RIM_LEVELS[1]), np.float32(1.0)
    room = np.empty((3, *drawn.shape), np.float32)
    weights, before, around = room[0], room[1], room[2]
    for state in range(len(drawn)):
        weight, level = weights[state], drawn[state]
        for q in range(len(level)):
            weight[q] = on_rim if level[q] > low and level[q] < high else one
    sums_around_kernel(np.ones(drawn.shape, np.float32), weights, keep, around)
    for state in range(len(drawn)):
        share = around[state]
        for q in range(len(share)):
            share[q] = one / share[q]
    for field in range(len(fields)):
        sums_around_kernel(fields[field], weights, keep, before)
        for state in range(len(drawn)):
            value, total, share = fields[field, state], before[state], around[state]
            for q in range(len(value)):
                value[q] -= total[q] * share[q]


# Rows as arrays of their own: several pixels are computed at once.
@njit(cache=True, nogil=True)
def sums_around_kernel(
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
    keep: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Fill in weighted sums over the states around, of which a share is kept from one to the next.

    All arrays are ``(states, pixels)``.
    """
    states, pixels = values.shape
    sums = np.zeros(pixels, np.float32)
    for state in range(states):
        value, weight, total = values[state], weights[state], out[state]
        for q in range(pixels):
            now = keep * sums[q] + weight[q] * value[q]
            sums[q] = now
            total[q] = now
    sums[:] = 0.0
    for back in range(states):
        state = states - 1 - back
        value, weight, total = values[state], weights[state], out[state]
        for q in range(pixels):
            after = keep * sums[q]
            total[q] += after
            sums[q] = after + weight[q] * value[q]
