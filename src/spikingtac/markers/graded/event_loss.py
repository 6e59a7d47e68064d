"""Event loss of the camera and its link: events that arrive over events that the motion causes.

A disc of radius R that moves by a distance sweeps 4 R of edge per px: its width, on the leading and
on the trailing side. Every swept pixel makes a full swing, which takes 1/step - 1 events of a
stream without loss; this defines a step. The ratio of events that arrive to events so expected,
taken where markers move, measures the loss. Events at rest are background. A reversal costs up to a
step of every pixel, and a filtered velocity lags, so the first part of each stroke is left out; a
few strokes then suffice. Fast edges send fewer events, since each blinds its pixel for a time.

Events are counted in the gate of each marker: a touch often moves few markers, whose events would
drown in the background of all the others.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import crossing_px, dead_time_of, events_per_px
from spikingtac.markers.graded.motion import AT_REST_PX_S
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray

# Speed below which a marker's events are not counted: creep, and the jitter of a filtered velocity.
SLOW_PX_S = 10.0

# Speed above which they are not counted either: a snap saturates the readout for some ms, and says
# nothing about the stream before and after.
FAST_PX_S = 400.0

BACKGROUND_MEMORY_S = 0.5  # Time constant of the background's running mean.

# Shortest stroke (motion in one direction) from which a marker's events are counted, in lengths
# over which its edge crosses one step. A reversal costs a step of each pixel of the edge: at 2 to
# 4 lengths 0.6 to 0.85 of the expected events arrive, from 5 on 0.92 and more (15 recordings
# without loss). With 2.4, at least 1 px, vibrations of 2.5 px pass for a loss of 0.2.
STROKE_CROSSINGS = 5.0

# Motion in the dead time over the length of a crossing that halves the events, and the speed at
# which steps are calibrated, px/s: swings of fast edges have fewer events. (Of a sensor with a dead
# time of 1 ms 1.2 of them arrive at 15 px/s, 0.83 at 180 px/s. With 1.5 for 0.8 fast hits and
# vibrations pass for a loss: ten simulated hits err by 8 % more, 2.5 px at 20 Hz by 50 % more
# with 10,000 estimates a second; none of 104 recordings errs by 2 % less.)
HALF_CROSSINGS, USUAL_PX_S = 0.8, 50.0

# A marker's events are counted where its motion causes this many times the background of its gate.
BACKGROUND_SHARE = 1.5

# Background assumed before the first rest: above what sensors have in good light.
LEAST_BACKGROUND_HZ_PX = 0.5

# Expected events before the first measurement of the ratio: hundredths of a second of lively
# motion. It must come before a disc lags too far to be believed.
FIRST_EVENTS = 500.0

# Ratio assumed until then. With too small steps a disc lags behind its marker, and a lagging disc
# shows little motion and so no loss; slightly too large steps cost next to nothing. (Training
# scenes: at 0.9 markers are lost where half of the events are missing.)
FIRST_RATIO = 0.8

# Expected events over which the ratio is averaged: some seconds of lively motion. Slow motions
# bring a tenth more than the mean, fast ones a tenth less (v2e, simulated): the mean needs both.
MEMORY_EVENTS = 150_000.0

# A larger ratio is within the spread of lossless recordings and counts as 1. (Fifteen simulated
# recordings have 0.9 to 1.08. Where v2e's two lack 8 to 20 %, they err by up to 22 % more at 0.87;
# at 0.94 six without loss err by 2 to 4 % more.)
LOSSLESS_RATIO = 0.9

# Shortest silence of a camera that has noise, us (cameras send batches of up to 10 ms), and least
# noise that is then missing, events: of pixels beside the markers, since these creep at rest.
SILENCE_US, SILENCE_EVENTS = 20_000, 20.0

SMALLEST_RATIO = 0.2  # At a smaller ratio no map can be tracked; the steps grow no further.


class EventLoss:
    """Estimates which share of the events arrives.

    Attributes:
        events_per_px: ``(m,)`` events of a stream without loss per px of the marker's motion.
        arrival_ratio: Events that arrive over events of a stream without loss; 1 without loss.
        background_hz_px: Events per px and second while the skin stands still.
    """

    def __init__(self, calibration: Calibration, area_px: NDArray[np.int64]) -> None:
        """Begin with :data:`FIRST_RATIO`.

        Args:
            calibration: Of the sensor.
            area_px: ``(m + 1,)`` pixels in each marker's gate, and last those in no gate.
        """
        self.events_per_px = events_per_px(calibration)
        crossings, dead_s = crossing_px(calibration), 1e-6 * dead_time_of(calibration)
        self._motion = STROKE_CROSSINGS * crossings, dead_s / (HALF_CROSSINGS * crossings)
        self._area_px = area_px.astype(np.float64)
        self._reversal_px = calibration.reference_px.astype(np.float64)
        self.background_hz_px, self._background_known = LEAST_BACKGROUND_HZ_PX, False
        self._beside_per_s = 0.0
        self._expected = self._arrived = 0.0
        self.arrival_ratio = FIRST_RATIO

    @property
    def measured(self) -> bool:
        """Whether enough events were expected to measure the ratio."""
        return self._expected >= FIRST_EVENTS

    @property
    def noise_per_s(self) -> FloatArray:
        """``(m + 1,)`` background events in each marker's gate, and last in no gate, 1/s."""
        return self.background_hz_px * self._area_px

    def is_silence(self, silent_s: float) -> bool:
        """Return whether so long a time without any event, s, is a gap in a stream with noise."""
        return silent_s * self._beside_per_s > SILENCE_EVENTS

    def update(self, markers: NDArray[np.void], counts: NDArray[np.int64], dt_s: float) -> None:
        """Update the background at rest, and the ratio from markers that move.

        Args:
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            counts: ``(m + 1,)`` events in each marker's gate, and last those in no gate.
            dt_s: Time in which they came, s; above 0.
        """
        mean_px_s, expected, arrived = expected_events_kernel(
            markers, self._reversal_px, counts, self.noise_per_s, self.events_per_px,
            *self._motion, dt_s,
        )  # fmt: skip
        if mean_px_s < AT_REST_PX_S:  # all events are background
            rate_hz_px = float(counts.sum()) / dt_s / float(self._area_px.sum())
            gain = 1.0 - math.exp(-dt_s / BACKGROUND_MEMORY_S) if self._background_known else 1.0
            self.background_hz_px += gain * (rate_hz_px - self.background_hz_px)
            self._beside_per_s += gain * (counts[-1] / dt_s - self._beside_per_s)
            self._background_known = True
        if expected <= 0.0:
            return
        memory = 1.0 - min(expected / MEMORY_EVENTS, 1.0)
        self._expected = memory * self._expected + expected
        self._arrived = memory * self._arrived + arrived
        if self.measured:
            ratio = self._arrived / self._expected
            self.arrival_ratio = 1.0 if ratio > LOSSLESS_RATIO else max(ratio, SMALLEST_RATIO)


@kernel()
def expected_events_kernel(
    markers: Array, reversal_px: Array, events: Array, noise_per_s: Array, events_per_px: Array,
    stroke_px: Array, halving_s_px: Array, dt_s: float,
) -> tuple[float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Return the mean speed, px/s, and the events that were expected and that arrived.

    Arguments are plain, since a tuple costs a microsecond: records of the markers; positions of the
    last reversals, which are updated; events in each gate, background per s, and events per px of
    motion; shortest stroke, px; the inverse of the speed that halves the events, s/px; the time, s.
    """
    speed_sum = expected = arrived = 0.0
    for m in range(len(markers)):
        x, y, vx, vy = markers[m].x, markers[m].y, markers[m].vx, markers[m].vy
        speed = np.hypot(vx, vy)
        speed_sum += speed
        signal_per_s = events_per_px[m] * speed
        stroke_x, stroke_y = x - reversal_px[m, 0], y - reversal_px[m, 1]
        if stroke_x * vx + stroke_y * vy < 0.0 or speed >= FAST_PX_S:
            reversal_px[m, 0], reversal_px[m, 1] = x, y
        steady = SLOW_PX_S < speed < FAST_PX_S and np.hypot(stroke_x, stroke_y) > stroke_px[m]
        if steady and signal_per_s > BACKGROUND_SHARE * noise_per_s[m]:
            fewer = (1.0 + USUAL_PX_S * halving_s_px[m]) / (1.0 + speed * halving_s_px[m])
            expected += fewer * signal_per_s * dt_s
            arrived += events[m] - noise_per_s[m] * dt_s
    return speed_sum / len(markers), expected, arrived
