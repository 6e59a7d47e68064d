"""Levels less each pixel's own offset, which is not known and drifts.

Where a pixel's level stood when the recording began cannot be told, so that only its changes from
state to state count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

RIM_LEVELS = (0.03, 0.97)
"""Between these levels a pixel lies on a rim."""

BLOCK_PIXELS = 64
"""Pixels whose offsets are removed together: 80 states of them take 120 kB."""


@dataclass(frozen=True, slots=True)
class OffsetMemory:
    """Which states tell the offset of a pixel's level, which noise and wrong steps let drift.

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


@njit(cache=True, nogil=True)
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
    states, pixels = drawn.shape
    keep = np.exp(-1.0 / offset_states)
    # Few pixels at a time, so that all of their states stay in the processor's cache.
    weight, known = np.empty((2, states, BLOCK_PIXELS))
    total, sums = np.empty((states, BLOCK_PIXELS)), np.empty(BLOCK_PIXELS)
    for first in range(0, pixels, BLOCK_PIXELS):
        count = min(BLOCK_PIXELS, pixels - first)
        weights_kernel(drawn, (first, count), (keep, rim_weight), (weight, known, sums))
        for field in range(len(fields)):
            sums[:] = 0.0
            for state in range(states):
                for q in range(count):
                    value = fields[field, state, first + q]
                    sums[q] = keep * sums[q] + weight[state, q] * value
                    total[state, q] = sums[q]
            sums[:] = 0.0
            for back in range(states):
                state = states - 1 - back
                for q in range(count):
                    value = fields[field, state, first + q]
                    mean = (total[state, q] + keep * sums[q]) / known[state, q]
                    sums[q] = keep * sums[q] + weight[state, q] * value
                    fields[field, state, first + q] = value - np.float32(mean)


@njit(cache=True, nogil=True)
def weights_kernel(
    drawn: NDArray[np.float32],
    block: tuple[int, int],
    memory: tuple[float, float],
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Fill in what each state of some pixels counts, and the sum of the weights around it.

    ``block`` is their first one and how many there are, ``memory`` what is kept from state to state
    and the weight on a rim. The third array of ``out`` is room for sums.
    """
    first, count = block
    keep, rim_weight = memory
    weight, known, sums = out
    states = len(drawn)
    sums[:] = 0.0
    for state in range(states):
        for q in range(count):
            on_rim = RIM_LEVELS[0] < drawn[state, first + q] < RIM_LEVELS[1]
            weight[state, q] = rim_weight if on_rim else 1.0
            sums[q] = keep * sums[q] + weight[state, q]
            known[state, q] = sums[q]
    sums[:] = 0.0
    for back in range(states):
        state = states - 1 - back
        for q in range(count):
            known[state, q] += keep * sums[q]
            sums[q] = keep * sums[q] + weight[state, q]
