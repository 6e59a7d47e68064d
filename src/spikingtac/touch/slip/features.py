"""What a slip model looks at: the shape of the field, and of its change over four spans of time.

All features are ratios, so that neither the heading of a drag nor its strength counts. The shape of
the whole field tells the slip that has been; the shape of its change tells where the skin still
moves with the body.

Where a contact sticks, the skin under it moves as one piece; where its rim slips, only the middle
does. So the share that sticks shows in how the shift of the skin falls off with the distance from
the contact's centre (C. Cattaneo 1938; R. D. Mindlin, "Compliance of elastic bodies in contact",
J. Appl. Mech. 16, 1949).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.pitch import marker_pitch_px

Field = NDArray[np.float64]

# Widths of the Gaussian windows, pitches of the markers (ours: from one marker to the patch).
WIDTHS = (0.6, 1.0, 1.6, 2.6)
MIDDLE = 1  # Index of the width by which strength and direction are told.

# Square of the arm, pitches squared, below which growth and turn are damped (ours).
LEAST_ARM = 0.05

# Weight of a marker that stands still, pitches squared, so that a field at rest has a centre.
LEAST_SQUARE = 1e-12

# Numbers of a summary: shifts (4, 2), growths (4,), turns (4,), centre (2,).
SIZE = 4 * len(WIDTHS) + 2


class FieldSummary:
    """Summarises the displacement fields of one sensor, in pitches of its markers.

    Attributes:
        pitch: Distance between neighbours, in the unit of the markers.
        places: ``(m, 2)`` the markers at rest, pitches.
        decay: ``(k,)`` halves of the inverse squared widths of the windows.
    """

    def __init__(self, reference: Field) -> None:
        """Prepare for markers ``(m, 2)`` at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self.pitch = marker_pitch_px(reference)
        self.places = np.ascontiguousarray(reference / self.pitch)
        self.decay = np.array([0.5 / width**2 for width in WIDTHS])

    def of(self, displacement: Field) -> Field:
        """Return the summary ``(SIZE,)`` of displacements ``(m, 2)`` in the unit of the markers.

        Shifts, growths and turns are in pitches (growth and turn: of a place one pitch from the
        centre); the centre is in pitches from the image's origin.
        """
        out = np.empty(SIZE)
        field_summary_kernel(self.places, displacement / self.pitch, self.decay, out)
        return out


@njit(cache=True, nogil=True)
def field_summary_kernel(places: Field, moved: Field, decay: Field, out: Field) -> None:
    """Summarise one field.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        moved: ``(m, 2)`` their displacements, pitches.
        decay: ``(k,)`` halves of the inverse squared widths.
        out: ``(4 k + 2,)`` overwritten.
    """
    widths, total, x0, y0 = len(decay), 0.0, 0.0, 0.0
    for marker in range(len(places)):
        square = moved[marker, 0] ** 2 + moved[marker, 1] ** 2 + LEAST_SQUARE
        total += square
        x0 += square * places[marker, 0]
        y0 += square * places[marker, 1]
    x0 /= total
    y0 /= total
    for k in range(widths):
        weight, x, y, arm, out_of, turn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for marker in range(len(places)):
            away_x, away_y = places[marker, 0] - x0, places[marker, 1] - y0
            far = away_x**2 + away_y**2
            share = np.exp(-decay[k] * far)
            u, v = moved[marker, 0], moved[marker, 1]
            weight += share
            x += share * u
            y += share * v
            arm += share * far
            out_of += share * (u * away_x + v * away_y)
            turn += share * (away_x * v - away_y * u)
        arm = arm / weight + LEAST_ARM
        out[2 * k], out[2 * k + 1] = x / weight, y / weight
        out[2 * widths + k] = out_of / weight / arm
        out[3 * widths + k] = turn / weight / arm
    out[4 * widths], out[4 * widths + 1] = x0, y0


# Spans over which changes are looked at, us (ours: a fast slide slips within 20 ms, a slow one
# moves by a tenth of a pixel in 40; with the shortest, and 10 ms among those of own_motion, 97 %
# of the slips are told in time instead of 94).
SPANS_US = (5_000, 10_000, 40_000, 160_000)

# Displacement, pitches, at which a field is as strong as the trackers' errors (0.3 of 37 px).
SCATTER = 0.008
CHANGE_SCATTER = 0.004  # The same of a change (ours: errors are alike from frame to frame).
USUAL_SPEED = 1.35  # Speed by which speeds are measured, pitches a second (50 px/s).
LEAST_SPEED = 0.02  # Share of that speed below which all are alike.
LARGEST = 6.0  # Features are clipped there.

# Weight and damping of the centre's motion, which errors move most where little changes.
CENTER_SHARE, CENTER_SLACK = 0.3, 0.1
SHAPE_FEATURES = 13
CHANGE_FEATURES = 11
FEATURES = SHAPE_FEATURES + CHANGE_FEATURES * len(SPANS_US)  # Number of features.

# Where the logarithm of the field's speed over each span stands among the features.
SPEEDS = tuple(SHAPE_FEATURES + CHANGE_FEATURES * span for span in range(len(SPANS_US)))
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
