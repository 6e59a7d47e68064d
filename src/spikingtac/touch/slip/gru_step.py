"""One step of a gated recurrent unit in one compiled pass: what a frame costs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]

LARGEST_LOGIT = 30.0
"""Limit of a logit, so that nothing overflows."""


class GruWeights(NamedTuple):
    """Weights of a step, each with its biases as the last column.

    Attributes:
        encoder: ``(e, f + 1)`` from features to their encoding, with their scaling.
        input_gates: ``(3 h, e + 1)`` from the encoding to the gates: reset, update, new.
        hidden_gates: ``(3 h, h + 1)`` from the hidden state to the same.
        head: ``(o, h + e + 1)`` from hidden state, then encoding, to the outputs.
    """

    encoder: Field
    input_gates: Field
    hidden_gates: Field
    head: Field


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def gru_step_kernel(weights: GruWeights, hidden: Field, features: Field, outputs: Field) -> Field:
    """Return the hidden state ``(h,)`` after a step and fill the outputs.

    Args:
        weights: Of the network.
        hidden: ``(h,)`` hidden state before.
        features: ``(f,)``.
        outputs: ``(o,)`` overwritten.
    """
    units = len(hidden)
    encoding, after = np.empty(len(weights.encoder)), np.empty(units)
    for row in range(len(encoding)):
        encoding[row] = np.tanh(_affine_kernel(weights.encoder[row], features))
    for unit in range(units):
        gate = _affine_kernel(weights.input_gates[unit], encoding)
        reset = _logistic_kernel(gate + _affine_kernel(weights.hidden_gates[unit], hidden))
        gate = _affine_kernel(weights.input_gates[units + unit], encoding)
        update = _logistic_kernel(gate + _affine_kernel(weights.hidden_gates[units + unit], hidden))
        new = _affine_kernel(weights.input_gates[2 * units + unit], encoding)
        kept = _affine_kernel(weights.hidden_gates[2 * units + unit], hidden)
        new = np.tanh(new + reset * kept)
        after[unit] = new + update * (hidden[unit] - new)
    for row in range(len(outputs)):
        logit = _affine_kernel(weights.head[row, units:], encoding)
        for unit in range(units):
            logit += weights.head[row, unit] * after[unit]
        outputs[row] = _logistic_kernel(logit)
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
