"""Who sleeps until when: a wheel of linked lists, one for each step to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

NOBODY = -1


class TimingWheel(NamedTuple):
    """Which pixels are awake, and when the others wake: a wheel of linked lists.

    Attributes:
        first: ``(slots,)`` pixel that wakes first in each step; -1 for none.
        following: ``(n,)`` the next pixel of the same list.
        awake: ``(n,)`` the pixels that are awake; the first ``up[0]`` are valid.
        up: ``(1,)`` how many they are.
        turn: ``(1,)`` slot of the present step.
    """

    first: NDArray[np.int32]
    following: NDArray[np.int32]
    awake: NDArray[np.int32]
    up: NDArray[np.int64]
    turn: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def schedule_kernel(beds: TimingWheel, pixel: int, steps: float) -> None:
    """Let a pixel sleep for some steps, at most once around the wheel."""
    slots = beds.first.shape[0]
    slot = (beds.turn[0] + int(min(steps, slots - 1.0))) % slots
    beds.following[pixel] = beds.first[slot]
    beds.first[slot] = pixel


@njit(cache=True, nogil=True, error_model="numpy")
def pop_due_kernel(beds: TimingWheel) -> None:
    """Wake the pixels of the present step and go on to the next one."""
    slot = beds.turn[0]
    woken = beds.first[slot]
    beds.first[slot] = NOBODY
    while woken >= 0:
        beds.awake[beds.up[0]] = woken
        beds.up[0] += 1
        woken = beds.following[woken]


def make_timing_wheel(pixels: int, slots: int) -> TimingWheel:
    """Return beds with everybody awake."""
    return TimingWheel(
        first=np.full(slots, NOBODY, np.int32),
        following=np.full(pixels, NOBODY, np.int32),
        awake=np.arange(pixels, dtype=np.int32),
        up=np.full(1, pixels, np.int64),
        turn=np.zeros(1, np.int64),
    )
