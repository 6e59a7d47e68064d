"""What a slip model looks at: the shape of the field, and of its change over spans of time.

All features are ratios, so that neither the heading of a drag nor its strength counts. The shape of
the whole field tells the slip that has been; the shape of its change tells where the skin still
moves with the body. What has moved of late also has a centre of its own, which is under the body:
one that has slid, rolled or circled leaves the skin deformed where it has been.

Where a contact sticks, the skin under it moves as one piece; where its rim slips, only the middle
does. So the share that sticks shows in how the shift of the skin falls off with the distance from
the contact's centre (C. Cattaneo 1938; R. D. Mindlin, "Compliance of elastic bodies in contact",
J. Appl. Mech. 16, 1949).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Field = NDArray[np.float64]

# Widths of the Gaussian windows, pitches of the markers: from one marker to the patch.
WIDTHS = (0.6, 1.0, 1.6, 2.6)
DECAY = 0.5 / np.array(WIDTHS) ** 2  # Halves of their inverse squares.
MIDDLE = 1  # Index of the width by which strength and direction are told.

# Square of the arm, pitches squared, below which growth and turn are damped.
LEAST_ARM = 0.05

# Weight of a marker that stands still, pitches squared, so that a field at rest has a centre.
LEAST_SQUARE = 1e-12

# Numbers of a summary: shifts (4, 2), growths (4,), turns (4,), centre (2,).
SIZE = 4 * len(WIDTHS) + 2

# Spans over which changes are looked at, us (a fast slide slips within 20 ms, a slow one moves by
# a tenth of a pixel in 40; with the shortest, and 10 ms among the motions', 97 % of the slips are
# told in time instead of 94).
SPANS_US = (5_000, 10_000, 40_000, 160_000)
MOTION_SPANS_US = (10_000, 25_000, 80_000)  # Spans over which motions are looked at, us.

# Displacement, pitches, at which a field is as strong as the trackers' errors (0.3 of 37 px).
SCATTER = 0.008
CHANGE_SCATTER = 0.004  # The same of a change: errors are alike from frame to frame.
USUAL_SPEED = 1.35  # Speed by which speeds are measured, pitches a second (50 px/s).
LEAST_SPEED = 0.02  # Share of that speed below which all are alike.
LARGEST = 6.0  # Features are clipped there.

# Weight and damping of the centre's motion, which errors move most where little changes.
CENTER_SHARE, CENTER_SLACK = 0.3, 0.1

# Displacement or motion, pitches, at which a centre or a heading is half known.
SLIGHT = 0.02
AWAY_SCALE = 0.5  # Makes distances of the centres, in pitches, of the order of one.

_K = len(WIDTHS)
_OTHERS = np.array([k for k in range(_K) if k != MIDDLE])

# Numbers of features: of the shape, of a change, of a motion (speed, shifts, growths and turns but
# the widest, and the centre's place), and of a frame.
SHAPE_FEATURES, CHANGE_FEATURES, MOTION_FEATURES = 13, 11, 2 * _K + 6
FIRST_MOTION = SHAPE_FEATURES + CHANGE_FEATURES * len(SPANS_US)
FEATURES = FIRST_MOTION + MOTION_FEATURES * len(MOTION_SPANS_US)

# Where the logarithm of the field's speed over each span stands among the features.
SPEEDS = tuple(SHAPE_FEATURES + CHANGE_FEATURES * span for span in range(len(SPANS_US)))


@njit(cache=True, nogil=True)
def field_summary_kernel(places: Field, moved: Field, out: Field) -> None:
    """Summarise one field.

    Shifts, growths and turns are in pitches (growth and turn: of a place one pitch from the
    centre); the centre is in pitches from the image's origin.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        moved: ``(m, 2)`` their displacements, pitches.
        out: ``(SIZE,)`` overwritten.
    """
    total, x0, y0 = 0.0, 0.0, 0.0
    for marker in range(len(places)):
        square = moved[marker, 0] ** 2 + moved[marker, 1] ** 2 + LEAST_SQUARE
        total += square
        x0 += square * places[marker, 0]
        y0 += square * places[marker, 1]
    x0 /= total
    y0 /= total
    for k in range(_K):
        weight, x, y, arm, out_of, turn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for marker in range(len(places)):
            away_x, away_y = places[marker, 0] - x0, places[marker, 1] - y0
            far = away_x**2 + away_y**2
            share = np.exp(-DECAY[k] * far)
            u, v = moved[marker, 0], moved[marker, 1]
            weight += share
            x += share * u
            y += share * v
            arm += share * far
            out_of += share * (u * away_x + v * away_y)
            turn += share * (away_x * v - away_y * u)
        arm = arm / weight + LEAST_ARM
        out[2 * k], out[2 * k + 1] = x / weight, y / weight
        out[2 * _K + k] = out_of / weight / arm
        out[3 * _K + k] = turn / weight / arm
    out[4 * _K], out[4 * _K + 1] = x0, y0


@njit(cache=True, nogil=True)
def slip_features_kernel(now: Field, before: Field, spans_s: Field, out: Field) -> None:
    """Fill the features ``(FIRST_MOTION,)`` of a field's shape and of its changes.

    Args:
        now: ``(SIZE,)`` summary of the field.
        before: ``(s, SIZE)`` summaries of the fields at the beginnings of the spans.
        spans_s: ``(s,)`` lengths of the spans, s.
        out: Overwritten.
    """
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
    x, y = 1.0, 0.0
    if strength > 0.0:
        x, y = now[2 * MIDDLE] / strength, now[2 * MIDDLE + 1] / strength
    for span in range(len(before)):
        change = now - before[span]
        part = out[SHAPE_FEATURES + CHANGE_FEATURES * span :]
        size = size_kernel(change)
        noisy = size + CHANGE_SCATTER
        part[0] = np.log(size / (spans_s[span] * USUAL_SPEED) + LEAST_SPEED)
        for k in range(_K):
            part[1 + k] = (change[2 * k] * x + change[2 * k + 1] * y) / noisy
        across = change[2 * MIDDLE + 1] * x - change[2 * MIDDLE] * y
        part[5], part[6] = abs(across) / noisy, change[2 * _K + MIDDLE] / noisy
        part[7] = change[3 * _K + MIDDLE] * np.sign(turn) / noisy
        part[8], part[9] = change[3 * _K - 1] / noisy, change[2 * _K] / noisy
        wander = change[4 * _K] * x + change[4 * _K + 1] * y
        part[10] = CENTER_SHARE * wander / (size / total + CENTER_SLACK)
    clip_kernel(out)


@njit(cache=True, nogil=True)
def own_motion_kernel(
    places: Field, motion: Field, now: Field, elapsed_us: int, out: Field
) -> None:
    """Fill the features ``(MOTION_FEATURES,)`` of a motion about its own centre.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        motion: ``(m, 2)`` how far the markers have moved of late, pitches.
        now: ``(SIZE,)`` summary of the whole field.
        elapsed_us: Time that the motion has taken, us.
        out: Overwritten.
    """
    own = np.empty(SIZE)
    field_summary_kernel(places, motion, own)
    size = size_kernel(own)
    noisy, known = size + CHANGE_SCATTER, size / (size + SLIGHT)
    elapsed_s = max(elapsed_us, 1) / 1e6
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
    clip_kernel(out)


@njit(cache=True, nogil=True)
def size_kernel(change: Field) -> float:
    """Return the root mean square over the widths of shifts, growths and turns of a change."""
    square = 0.0
    for k in range(4 * _K):
        square += change[k] ** 2
    return float(np.sqrt(square / _K))


@njit(cache=True, nogil=True)
def clip_kernel(out: Field) -> None:
    """Clip features at their largest amount."""
    for k in range(len(out)):
        out[k] = min(max(out[k], -LARGEST), LARGEST)


@njit(cache=True, nogil=True)
def spans_kernel(
    times_us: NDArray[np.int64],
    rows: Field,
    count: int,
    spans_us: NDArray[np.int64],
    starts: NDArray[np.int64],
    before: Field,
) -> None:
    """Fill the rows at the beginnings of the spans.

    Args:
        times_us: ``(c,)`` times of the frames, us; frame k lies in slot k modulo c.
        rows: ``(c, n)`` what is kept of each.
        count: Frames so far.
        spans_us: ``(s,)`` spans up to the last frame, us.
        starts: ``(s,)`` number of the frame at which each began before; moved on to the last one
            at or before its beginning, or to the first that is remembered.
        before: ``(s, n)`` overwritten.
    """
    capacity = len(times_us)
    now = (count - 1) % capacity
    for number in range(len(spans_us)):
        start = max(starts[number], count - capacity)
        begin_us = times_us[now] - spans_us[number]
        while start + 1 < count and times_us[(start + 1) % capacity] <= begin_us:
            start += 1
        starts[number] = start
        for k in range(rows.shape[1]):
            before[number, k] = rows[start % capacity, k]
