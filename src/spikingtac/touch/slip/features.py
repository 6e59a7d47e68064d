"""What a slip model looks at: the shape of the field, and of its change over four spans of time.

All features are ratios, so that neither the heading of a drag nor its strength counts. The shape of
the whole field tells the slip that has been; the shape of its change tells where the skin still
moves with the body.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.slip.field_summary import MIDDLE, WIDTHS

Field = NDArray[np.float64]

SPANS_US = (5_000, 10_000, 40_000, 160_000)
"""Spans over which changes are looked at, us (ours: a fast slide slips within 20 ms, a slow one
moves by a tenth of a pixel in 40; with the shortest, and
10 ms among those of own_motion, 97 % of the slips are told in time instead of 94)."""
SCATTER = 0.008
"""Displacement, pitches, at which a field is as strong as the trackers' errors (0.3 of 37 px)."""
CHANGE_SCATTER = 0.004
"""The same of a change (ours: errors are alike from frame to frame)."""
USUAL_SPEED = 1.35
"""Speed by which speeds are measured, pitches a second (50 px/s)."""
LEAST_SPEED = 0.02
"""Share of that speed below which all are alike."""
LARGEST = 6.0
"""Features are clipped there."""
CENTER_SHARE, CENTER_SLACK = 0.3, 0.1
"""Weight and damping of the centre's motion, which errors move most where little changes."""
SHAPE_FEATURES = 13
CHANGE_FEATURES = 11
FEATURES = SHAPE_FEATURES + CHANGE_FEATURES * len(SPANS_US)
"""Number of features."""
SPEEDS = tuple(SHAPE_FEATURES + CHANGE_FEATURES * span for span in range(len(SPANS_US)))
"""Where the logarithm of the field's speed over each span stands among the features."""
_K = len(WIDTHS)
_OTHERS = np.array([k for k in range(_K) if k != MIDDLE])


def slip_features(now: Field, before: Field, spans_s: Field) -> Field:
    """Return the features ``(FEATURES,)`` of a field.

    Args:
        now: ``(SIZE,)`` summary of the field.
        before: ``(s, SIZE)`` summaries of the fields at the beginnings of the spans.
        spans_s: ``(s,)`` lengths of the spans, s.
    """
    out = np.empty(FEATURES)
    slip_features_kernel(now, before, spans_s, out)
    return out


@njit(cache=True, nogil=True)
def slip_features_kernel(now: Field, before: Field, spans_s: Field, out: Field) -> None:
    """Fill ``out`` with the features; see :func:`slip_features`."""
    strength = np.hypot(now[2 * MIDDLE], now[2 * MIDDLE + 1])
    growth, turn = now[2 * _K + MIDDLE], now[3 * _K + MIDDLE]
    total = np.sqrt(strength**2 + growth**2 + turn**2) + SCATTER
    out[0] = np.log(total / SCATTER)
    out[1], out[2], out[3] = strength / total, growth / total, abs(turn) / total
    for number in range(len(_OTHERS)):
        k = _OTHERS[number]
        out[4 + number] = np.hypot(now[2 * k], now[2 * k + 1]) / (strength + SCATTER)
        out[7 + number] = now[2 * _K + k] * np.sign(growth) / (abs(growth) + SCATTER)
        out[10 + number] = abs(now[3 * _K + k]) / (abs(turn) + SCATTER)
    along_x, along_y = 1.0, 0.0
    if strength > 0.0:
        along_x, along_y = now[2 * MIDDLE] / strength, now[2 * MIDDLE + 1] / strength
    for span in range(len(before)):
        first = SHAPE_FEATURES + CHANGE_FEATURES * span
        change = now - before[span]
        _change_kernel(change, along_x, along_y, np.sign(turn), total, spans_s[span], out, first)
    for number in range(len(out)):
        out[number] = min(max(out[number], -LARGEST), LARGEST)


@njit(cache=True, nogil=True)
def _change_kernel(
    change: Field,
    along_x: float,
    along_y: float,
    sense: float,
    total: float,
    span_s: float,
    out: Field,
    first: int,
) -> None:
    """Fill the features of the change over one span, from ``out[first]`` on."""
    square = 0.0
    for k in range(4 * _K):
        square += change[k] ** 2
    size = np.sqrt(square / _K)
    noisy = size + CHANGE_SCATTER
    out[first] = np.log(size / (span_s * USUAL_SPEED) + LEAST_SPEED)
    for k in range(_K):
        out[first + 1 + k] = (change[2 * k] * along_x + change[2 * k + 1] * along_y) / noisy
    across = change[2 * MIDDLE + 1] * along_x - change[2 * MIDDLE] * along_y
    out[first + 5] = abs(across) / noisy
    out[first + 6] = change[2 * _K + MIDDLE] / noisy
    out[first + 7] = change[3 * _K + MIDDLE] * sense / noisy
    out[first + 8] = change[3 * _K - 1] / noisy
    out[first + 9] = change[2 * _K] / noisy
    wander = change[4 * _K] * along_x + change[4 * _K + 1] * along_y
    out[first + 10] = CENTER_SHARE * wander / (size / total + CENTER_SLACK)
