"""One step of a stick network in one compiled pass: what a frame costs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]

LARGEST_LOGIT = 30.0
"""Limit of a logit, so that nothing overflows."""


class StepWeights(NamedTuple):
    """Weights of a step, each with its offsets as the last column.

    Attributes:
        seen: ``(s, f + 1)`` from features to what is seen, their scaling included.
        fresh: ``(3 m, s + 1)`` from what is seen to reset, update and new.
        kept: ``(3 m, m + 1)`` from the memory to the same.
        told: ``(o, m + s + 1)`` from the memory, then what is seen, to the outputs.
    """

    seen: Field
    fresh: Field
    kept: Field
    told: Field


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def stick_step_kernel(weights: StepWeights, memory: Field, features: Field, said: Field) -> Field:
    """Return the memory ``(m,)`` after a step and fill the outputs.

    Args:
        weights: Of the network.
        memory: ``(m,)`` what was remembered before.
        features: ``(f,)``.
        said: ``(o,)`` overwritten.
    """
    units = len(memory)
    seen, after = np.empty(len(weights.seen)), np.empty(units)
    for row in range(len(seen)):
        seen[row] = np.tanh(_affine_kernel(weights.seen[row], features))
    for unit in range(units):
        gate = _affine_kernel(weights.fresh[unit], seen)
        reset = _logistic_kernel(gate + _affine_kernel(weights.kept[unit], memory))
        gate = _affine_kernel(weights.fresh[units + unit], seen)
        update = _logistic_kernel(gate + _affine_kernel(weights.kept[units + unit], memory))
        new = _affine_kernel(weights.fresh[2 * units + unit], seen)
        new = np.tanh(new + reset * _affine_kernel(weights.kept[2 * units + unit], memory))
        after[unit] = new + update * (memory[unit] - new)
    for row in range(len(said)):
        logit = _affine_kernel(weights.told[row, units:], seen)
        for unit in range(units):
            logit += weights.told[row, unit] * after[unit]
        said[row] = _logistic_kernel(logit)
    return after


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def _affine_kernel(row: Field, values: Field) -> float:
    """Return a row of weights times values, and its last number added."""
    total = row[len(values)]
    for k in range(len(values)):
        total += row[k] * values[k]
    return total


@njit(cache=True, nogil=True, forceinline=True)
def _logistic_kernel(logit: float) -> float:
    return 1.0 / (1.0 + np.exp(-min(max(logit, -LARGEST_LOGIT), LARGEST_LOGIT)))
