"""Timing wheel of pending pixel updates: one linked list of pixels for each coming step.

Source of the data structure: Varghese & Lauck, SOSP 1987, doi:10.1145/41457.37504.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

EMPTY = -1
"""End of a linked list."""


class TimingWheel(NamedTuple):
    """Pixels that are active now, and the step in which each other pixel becomes active again.

    Attributes:
        first: ``(slots,)`` first pixel of each slot's list; -1 if the list is empty.
        following: ``(n,)`` next pixel of the same list; -1 at its end.
        active: ``(n,)`` active pixels. The first ``active_count[0]`` are valid.
        active_count: ``(1,)`` number of active pixels.
        slot: ``(1,)`` slot of the present step.
    """

    first: NDArray[np.int32]
    following: NDArray[np.int32]
    active: NDArray[np.int32]
    active_count: NDArray[np.int64]
    slot: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def schedule_kernel(wheel: TimingWheel, pixel: int, steps: float) -> None:
    """Make a pixel inactive for a number of steps, at most one turn of the wheel."""
    slots = wheel.first.shape[0]
    slot = (wheel.slot[0] + int(min(steps, slots - 1.0))) % slots
    wheel.following[pixel] = wheel.first[slot]
    wheel.first[slot] = pixel


@njit(cache=True, nogil=True, error_model="numpy")
def pop_due_kernel(wheel: TimingWheel) -> None:
    """Make the pixels of the present slot active and empty the slot."""
    slot = wheel.slot[0]
    pixel = wheel.first[slot]
    wheel.first[slot] = EMPTY
    while pixel >= 0:
        wheel.active[wheel.active_count[0]] = pixel
        wheel.active_count[0] += 1
        pixel = wheel.following[pixel]


def make_timing_wheel(pixels: int, slots: int) -> TimingWheel:
    """Return a wheel with ``slots`` steps, in which all ``pixels`` pixels are active."""
    return TimingWheel(
        first=np.full(slots, EMPTY, np.int32),
        following=np.full(pixels, EMPTY, np.int32),
        active=np.arange(pixels, dtype=np.int32),
        active_count=np.full(1, pixels, np.int64),
        slot=np.zeros(1, np.int64),
    )
