"""The shape of the field's latest motion about its own centre.

A body that has slid, rolled or circled leaves the skin deformed where it has been, so the centre of
the whole field lies behind the contact. What has moved of late has a centre of its own, which is
under the body, and its shape about it shows how much of the skin still goes with the body.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.slip.features import (
    CHANGE_SCATTER,
    LARGEST,
    LEAST_SPEED,
    MIDDLE,
    SIZE,
    USUAL_SPEED,
    WIDTHS,
    field_summary_kernel,
)

Field = NDArray[np.float64]

# Spans over which motions are looked at, us (ours: about those of the changes).
SPANS_US = (10_000, 25_000, 80_000)

# Displacement or motion, pitches, at which a centre or a heading is half known (ours).
SLIGHT = 0.02

# Factor that makes distances of the centres, in pitches, of the order of one (ours).
AWAY_SCALE = 0.5
_K = len(WIDTHS)

# Of one span: speed, shifts, growths and turns but the widest, and the centre's place.
SPAN_FEATURES = 2 * _K + 6
FEATURES = SPAN_FEATURES * len(SPANS_US)  # Number of features.
US_PER_S = 1e6


@njit(cache=True, nogil=True)
def own_motion_kernel(
    places: Field,
    decay: Field,
    motion: Field,
    now: Field,
    elapsed_us: int,
    out: Field,
) -> None:
    """Fill the features ``(SPAN_FEATURES,)`` of a motion.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        decay: ``(k,)`` halves of the inverse squared widths.
        motion: ``(m, 2)`` how far the markers have moved of late, pitches.
        now: ``(SIZE,)`` summary of the whole field.
        elapsed_us: Time that the motion has taken, us.
        out: Overwritten.
    """
    own = np.empty(SIZE)
    field_summary_kernel(places, motion, decay, own)
    square = 0.0
    for k in range(4 * _K):
        square += own[k] ** 2
    size = np.sqrt(square / _K)
    noisy, known = size + CHANGE_SCATTER, size / (size + SLIGHT)
    elapsed_s = max(elapsed_us, 1) / US_PER_S
    out[0] = np.log(size / (elapsed_s * USUAL_SPEED) + LEAST_SPEED)
    for k in range(_K):
        out[1 + k] = np.hypot(own[2 * k], own[2 * k + 1]) / noisy
    for k in range(_K - 1):
        out[1 + _K + k] = own[2 * _K + k] / noisy
        out[2 * _K + k] = abs(own[3 * _K + k]) / noisy
    length = np.hypot(own[2 * MIDDLE], own[2 * MIDDLE + 1])
    x, y = 1.0, 0.0
    if length > 0.0:
        x, y = own[2 * MIDDLE] / length, own[2 * MIDDLE + 1] / length
    away_x, away_y = own[4 * _K] - now[4 * _K], own[4 * _K + 1] - now[4 * _K + 1]
    last = 3 * _K - 1
    out[last] = AWAY_SCALE * known * (away_x * x + away_y * y)
    out[last + 1] = AWAY_SCALE * known * abs(away_y * x - away_x * y)
    along = now[2 * MIDDLE] * x + now[2 * MIDDLE + 1] * y
    strength = np.hypot(now[2 * MIDDLE], now[2 * MIDDLE + 1])
    out[last + 2] = known * along / (strength + SLIGHT)
    for k in range(SPAN_FEATURES):
        out[k] = min(max(out[k], -LARGEST), LARGEST)
