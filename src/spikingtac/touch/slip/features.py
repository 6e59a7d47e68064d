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

from bisect import bisect_right
from math import log

import numpy as np

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.types import US_PER_S, FloatArray

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


# Frames further apart say nothing of slip: the shortest span must hold some, us.
LONGEST_GAP_US = 6_000

# Change over the longest span, pitches, below which the skin stands still: 0.3 of 37 px (a
# tracker's errors make a third of it, a drag of 2 mm/s makes it in 10 ms).
STILL = 0.008

# Speed over the middle span, as a share of the usual one, below which it stands still, too: 0.03
# px in 40 ms (0.008 to 0.03 are alike; the errors of a tracker make 0.005).
PAUSED = 0.017


def summaries(places: FloatArray, moved: FloatArray) -> FloatArray:
    """Summarise fields, ``(f, SIZE)``.

    Shifts, growths and turns are in pitches (growth and turn: of a place one pitch from the
    centre); the centre is in pitches from the image's origin.

    Args:
        places: ``(m, 2)`` markers at rest, pitches.
        moved: ``(f, m, 2)`` their displacements, pitches.
    """
    square = (moved**2).sum(axis=2) + LEAST_SQUARE
    center = square @ places / square.sum(axis=1, keepdims=True)
    away = places - center[:, None]
    far = (away**2).sum(axis=2)
    share = np.exp(-DECAY[:, None] * far[:, None])
    share /= share.sum(axis=2, keepdims=True)
    crossed = away[..., 0] * moved[..., 1] - away[..., 1] * moved[..., 0]
    sums = share @ np.stack(
        [*np.moveaxis(moved, 2, 0), far, (moved * away).sum(axis=2), crossed], 2
    )
    arm = sums[..., 2] + LEAST_ARM
    shifts = sums[..., :2].reshape(len(moved), -1)
    return np.hstack([shifts, sums[..., 3] / arm, sums[..., 4] / arm, center])


def _parts(
    summary: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return shifts ``(..., 4, 2)``, growths, turns, centre and size of summaries.

    The size is the root mean square over the widths of shifts, growths and turns.
    """
    shifts = summary[..., : 2 * _K].reshape(*summary.shape[:-1], _K, 2)
    growths, turns = summary[..., 2 * _K : 3 * _K], summary[..., 3 * _K : 4 * _K]
    size = np.sqrt((summary[..., : 4 * _K] ** 2).sum(axis=-1) / _K)
    return shifts, growths, turns, summary[..., 4 * _K :], size


def _direction(shift: FloatArray) -> FloatArray:
    """Return unit vectors ``(..., 2)`` along shifts; along x where there is none."""
    length = np.hypot(shift[..., :1], shift[..., 1:])
    return np.where(length > 0.0, shift / np.where(length > 0.0, length, 1.0), [1.0, 0.0])


def _speeds(size: FloatArray) -> FloatArray:
    """Return the logarithms of the speeds of changes over the spans, from their sizes ``(s,)``."""
    return np.log(size / (np.array(SPANS_US) / US_PER_S * USUAL_SPEED) + LEAST_SPEED)


def shape_features(now: FloatArray, before: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the features ``(SHAPE_FEATURES,)`` of a field's shape and those of its changes.

    Args:
        now: ``(SIZE,)`` summary of the field.
        before: ``(s, SIZE)`` summaries of the fields at the beginnings of the spans.
    """
    shifts, growths, turns, _, _ = _parts(now)
    lengths = np.hypot(shifts[:, 0], shifts[:, 1])
    strength, growth, turn = lengths[MIDDLE], growths[MIDDLE], turns[MIDDLE]
    total = np.sqrt(strength**2 + growth**2 + turn**2) + SCATTER
    shape = np.hstack(
        [
            [log(total / SCATTER), strength / total, growth / total, abs(turn) / total],
            lengths[_OTHERS] / (strength + SCATTER),
            growths[_OTHERS] * np.sign(growth) / (abs(growth) + SCATTER),
            np.abs(turns[_OTHERS]) / (abs(turn) + SCATTER),
        ]
    )
    x, y = along = _direction(shifts[MIDDLE])
    shifts, growths, turns, center, size = _parts(now - before)
    noisy = size + CHANGE_SCATTER
    changes = np.column_stack(
        [
            _speeds(size),
            shifts @ along / noisy[:, None],
            np.abs(shifts[:, MIDDLE, 1] * x - shifts[:, MIDDLE, 0] * y) / noisy,
            growths[:, MIDDLE] / noisy,
            turns[:, MIDDLE] * np.sign(turn) / noisy,
            growths[:, -1] / noisy,
            growths[:, 0] / noisy,
            CENTER_SHARE * (center @ along) / (size / total + CENTER_SLACK),
        ]
    )
    return shape, changes


def motion_features(own: FloatArray, now: FloatArray, elapsed_s: FloatArray) -> FloatArray:
    """Return the features ``(k, MOTION_FEATURES)`` of motions about their own centres.

    Args:
        own: ``(k, SIZE)`` summaries of how far the markers have moved of late.
        now: ``(SIZE,)`` summary of the whole field.
        elapsed_s: ``(k,)`` times that the motions have taken, s.
    """
    shifts, growths, turns, center, size = _parts(own)
    whole, _, _, whole_center, _ = _parts(now)
    noisy, known = (size + CHANGE_SCATTER)[:, None], size / (size + SLIGHT)
    along, away = _direction(shifts[:, MIDDLE]), center - whole_center
    across = away[:, 1] * along[:, 0] - away[:, 0] * along[:, 1]
    return np.column_stack(
        [
            np.log(size / (elapsed_s * USUAL_SPEED) + LEAST_SPEED),
            np.hypot(shifts[..., 0], shifts[..., 1]) / noisy,
            growths[:, :-1] / noisy,
            np.abs(turns[:, :-1]) / noisy,
            AWAY_SCALE * known * (away * along).sum(axis=1),
            AWAY_SCALE * known * np.abs(across),
            known * (along @ whole[MIDDLE]) / (np.hypot(*whole[MIDDLE]) + SLIGHT),
        ]
    )


class FeatureStream:
    """Turns displacement fields into features, causally, with a memory of the longest span.

    Example:
        >>> axes = np.meshgrid(np.arange(8.0), np.arange(8.0))
        >>> reference = 37.0 * np.column_stack([axis.ravel() for axis in axes])
        >>> stream = FeatureStream(reference)
        >>> stream.update(0, np.zeros((64, 2))) is None  # nothing is known of its change
        True
        >>> stream.update(1_000, np.ones((64, 2))).shape
        (99,)

    Attributes:
        known: Whether the last two frames were near enough to each other.
        still: Whether the skin stood still over the longest span or, more strictly, the middle one.
        slowing: Logarithm of the field's speed over 10 ms by that over the longest span.
    """

    def __init__(self, reference: FloatArray) -> None:
        """Start without a memory.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.

        Raises:
            ConfigError: Fewer than two markers.
        """
        self._pitch = marker_pitch_px(reference)
        self._places = reference / self._pitch
        self.reset()

    def reset(self) -> None:
        """Forget every frame."""
        self._times: list[int] = []
        self._moved: list[FloatArray] = []
        self._summaries: list[FloatArray | None] = []
        self.known, self.still, self.slowing = False, True, 0.0

    def update(
        self, t_us: int, displacement: FloatArray, wanted: bool = True, due: bool = True
    ) -> FloatArray | None:
        """Take in displacements ``(m, 2)`` from the rest and return their features, if due.

        What :attr:`still` and :attr:`slowing` say follows every frame that is wanted.

        Returns:
            ``(FEATURES,)``, or None for the first frame and after a gap.
        """
        if self._times and not 0 < t_us - self._times[-1] <= LONGEST_GAP_US:
            self.reset()
        self.known = bool(self._times)
        self._times.append(t_us)
        self._moved.append(displacement / self._pitch)
        self._summaries.append(None)
        # The longest span begins at the first frame that is kept.
        while len(self._times) > 1 and self._times[1] <= t_us - SPANS_US[-1]:
            del self._times[0], self._moved[0], self._summaries[0]
        return self._features(t_us, due) if wanted and self.known else None

    def _features(self, t_us: int, due: bool) -> FloatArray | None:
        ends_us = t_us - np.array((*SPANS_US, *MOTION_SPANS_US))
        starts = [max(bisect_right(self._times, end_us) - 1, 0) for end_us in ends_us.tolist()]
        spans, motions = starts[: len(SPANS_US)], starts[len(SPANS_US) :] if due else []
        # Most spans begin with a frame that was summarised when it came.
        missing = [k for k in dict.fromkeys(spans) if self._summaries[k] is None]
        last = self._moved[-1]
        moved = [*(last - self._moved[k] for k in motions), *(self._moved[k] for k in missing)]
        now, *rows = summaries(self._places, np.array([last, *moved]))
        self._summaries[-1] = now
        for k, row in zip(missing, rows[len(motions) :], strict=True):
            self._summaries[k] = row
        before = np.array([self._summaries[k] for k in spans])
        # Shifts, growths and turns over the longest span; the centre's place is no motion.
        change = float(((now - before[-1])[: 4 * _K] ** 2).sum())
        _, short, middle, long = np.minimum(_speeds(_parts(now - before)[4]), LARGEST).tolist()
        self.still = middle < log(PAUSED + LEAST_SPEED) or change < len(WIDTHS) * STILL**2
        self.slowing = short - long
        if not due:
            return None
        shape, changes = shape_features(now, before)
        elapsed_s = np.maximum(t_us - np.array([self._times[k] for k in motions]), 1) / US_PER_S
        own = motion_features(np.array(rows[: len(motions)]), now, elapsed_s)
        return np.concatenate([shape, changes.ravel(), own.ravel()]).clip(-LARGEST, LARGEST)
