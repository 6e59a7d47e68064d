"""How many of the events that the motion asks for arrive: cameras and cables lose some.

A disc of radius R that moves by a distance sweeps 4 R of edge per px (its width, on the leading and
on the trailing side), and every swept pixel swings fully, which takes 1/step - 1 events of a clean
stream: so a step is defined. The share of events over that expectation, measured where markers
move, tells the loss; what arrives at rest is background. A reversal costs up to a step of every
pixel and a filtered velocity lags, so that the first px after a turn is left out: then a few
strokes suffice.

Events are counted around each marker where it stands: a touch often moves few markers, whose events
would drown in the background of all the others.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import crossing_px, events_per_px
from spikingtac.markers.graded.motion import VX, VY, X, Y
from spikingtac.state_map.graded import Array

# Speed below which a marker is not asked: creep, and the jitter of a filtered velocity.
SLOW_PX_S = 10.0

# Speed above which it is not: a snap overruns the readout for some ms, and says nothing about the
# stream before and after.
FAST_PX_S = 400.0

STILL_PX_S = 3.0  # Mean speed below which all events are background.

BACKGROUND_MEMORY_S = 0.5  # Time constant of the background's running mean.

# A marker is asked after it went this far in one direction. A reversal costs a step of each pixel
# of its edge, and the events of a shorter motion tell of that and not of the stream (measured on
# training scenes: over 2,000 expected events each the shares scatter by 0.1, without it by 0.2).
# That is in ways in which an edge crosses a step, within bounds in px. (With 1 px alone a blurred
# sensor's first stroke is taken for a loss of half, and its error is a quarter larger; longer ones
# are rare; simulated.)
STROKE_CROSSINGS, STROKES_PX = 2.4, (1.0, 2.5)

# A marker is asked where its motion causes this many times the background around it.
BACKGROUND_SHARE = 1.5

# Background that is assumed until a rest was seen: above what sensors have in good light.
LEAST_BACKGROUND_HZ_PX = 0.5

# Expected events before the first judgement: hundredths of a second of lively motion. It must
# come before a disc lags too far to be believed.
FIRST_EVENTS = 500.0

# Share that is assumed until then. Steps that are too small let a disc lag behind its marker, and
# a lagging disc sees little motion and so no loss; steps a little too large cost next to nothing
# (measured on training scenes: at 0.9 markers are lost where half of the events are missing).
FIRST_SHARE = 0.8

# Expected events over which the share is averaged: some seconds of lively motion. Slow motions
# bring a tenth more than the mean, fast ones a tenth less (v2e, simulated): both must be seen.
MEMORY_EVENTS = 150_000.0

# A share above this is within the spread of lossless recordings and counts as 1 (v2e, simulated:
# 0.84 to 1.05 without loss; at 0.84 first strokes that lack 30 % are taken for whole).
FULL_SHARE = 0.87

SMALLEST_SHARE = 0.2  # Below this no map can be kept; the steps grow no further.


class EventLoss:
    """Watches the stream for loss.

    Attributes:
        events_per_px: ``(m,)`` events of a whole stream per px of the marker's motion.
        share: Events that arrive over those that a whole stream would bring; 1 without loss.
        background_hz_px: Events per px and second while the skin stands still.
    """

    def __init__(self, calibration: Calibration, area_px: NDArray[np.int64]) -> None:
        """Begin with :data:`FIRST_SHARE`.

        Args:
            calibration: Of the sensor.
            area_px: ``(m + 1,)`` pixels around each marker, and around none.
        """
        self.events_per_px = events_per_px(calibration)
        self._stroke_px = (STROKE_CROSSINGS * crossing_px(calibration)).clip(*STROKES_PX)
        self._area_px = area_px.astype(np.float64)
        self._turn_px = calibration.reference_px.astype(np.float64)
        self.background_hz_px, self._measured = LEAST_BACKGROUND_HZ_PX, False
        self._expected = self._arrived = 0.0
        self.share = FIRST_SHARE

    @property
    def judged(self) -> bool:
        """Whether the share was measured yet."""
        return self._expected >= FIRST_EVENTS

    @property
    def noise_per_s(self) -> NDArray[np.float64]:
        """``(m,)`` background events around each marker, 1/s."""
        return self.background_hz_px * self._area_px[:-1]

    def update(self, motion: NDArray[np.float64], counts: NDArray[np.int64], dt_s: float) -> None:
        """Judge what was counted.

        Args:
            motion: ``(m, 8)`` states of the markers (:mod:`spikingtac.markers.graded.motion`).
            counts: ``(m + 1,)`` events around each marker, and around none.
            dt_s: Time in which they came, s; above 0.
        """
        mean_px_s, expected, arrived = motion_kernel(
            motion, self._turn_px, counts, self.noise_per_s, self.events_per_px, self._stroke_px,
            dt_s,
        )  # fmt: skip
        if mean_px_s < STILL_PX_S:
            rate_hz_px = float(counts.sum()) / dt_s / float(self._area_px.sum())
            gain = 1.0 - math.exp(-dt_s / BACKGROUND_MEMORY_S) if self._measured else 1.0
            self.background_hz_px += gain * (rate_hz_px - self.background_hz_px)
            self._measured = True
        if expected <= 0.0:
            return
        kept = 1.0 - min(expected / MEMORY_EVENTS, 1.0)
        self._expected = kept * self._expected + expected
        self._arrived = kept * self._arrived + arrived
        if self.judged:
            share = self._arrived / self._expected
            self.share = 1.0 if share > FULL_SHARE else max(share, SMALLEST_SHARE)


@kernel()
def motion_kernel(
    motions: Array, turn_px: Array, events: Array, noise_per_s: Array, events_per_px: Array,
    stroke_px: Array, dt_s: float,
) -> tuple[float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Return the mean speed, px/s, and the events that were expected and that arrived.

    Arguments are plain, since a tuple costs a microsecond: motions, and where each turned last,
    which is kept up to date; events around each, background per s, and events per px of motion;
    the shortest way since the turn, px; the time, s.
    """
    total = expected = arrived = 0.0
    for m in range(motions.shape[0]):
        x, y, vx, vy = motions[m, X], motions[m, Y], motions[m, VX], motions[m, VY]
        speed = np.hypot(vx, vy)
        total += speed
        asked = events_per_px[m] * speed
        way_x, way_y = x - turn_px[m, 0], y - turn_px[m, 1]
        if way_x * vx + way_y * vy < 0.0 or speed >= FAST_PX_S:
            turn_px[m, 0], turn_px[m, 1] = x, y
        steady = SLOW_PX_S < speed < FAST_PX_S and np.hypot(way_x, way_y) > stroke_px[m]
        if steady and asked > BACKGROUND_SHARE * noise_per_s[m]:
            expected += asked * dt_s
            arrived += events[m] - noise_per_s[m] * dt_s
    return total / motions.shape[0], expected, arrived
