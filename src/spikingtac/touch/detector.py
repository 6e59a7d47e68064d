"""Touches from a stream of marker frames: begin, end, place, area and peak of each.

What is watched is the strength of the displacement's gradient: pressing, twisting and dragging
strain the skin, while errors that all markers share do not. A touch begins where the strength
leaves that of the rest, and ends where it has fallen to a share of the touch's peak and stays
there. What remains after a release becomes the new rest, so creep is no touch.

This detector tells touches apart and measures them. To stop a robot use
:mod:`spikingtac.contact`, which decides from raw events within a millisecond.
"""

from dataclasses import dataclass

import numpy as np

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.touch.field import FieldGauge, GradientOperator, LostMarkers, spread_of
from spikingtac.touch.onset import OnsetMemory
from spikingtac.touch.patch import Patch, PatchEstimator
from spikingtac.touch.touch import END_SHARE, CalibratedRest, OpenTouch, Release, Touch, spreads
from spikingtac.types import FloatArray, MarkerFrame

# Scatter of a marker of an event camera that is no touch, px (twenty times the scatter of the
# tracker ``default`` on the twin at rest; its steps are smaller), and of one of another sensor, as
# a share of the pitch (0.045 mm of 1.6 mm on a published series at rest). The threshold of a touch
# is the gradient's strength of markers that scatter so.
SCATTER_PX, SCATTER_SHARE = 0.2, 0.03

# Share of the peak's spread below which the skin is released, whatever few markers say.
SPREAD_SHARE = 0.1

SPREAD_FACTOR = 5.0  # Times a marker's scatter that the spread must have reached for that.
SPREAD_MARKERS = 0.6  # Share of the markers that must be back.

# Share of the strength at which a touch begins below which it is over, whatever its peak: a faint
# one leaves as much behind in the tracker (0.79 to 0.87 of it after presses of a ball that
# reach 1.5 to 3 times of it, simulated).
FAINT_SHARE = 0.95

# What begins so soon after a touch and stays below this share of its peak is its release: pixels
# that recover let the markers fall back one by one for 0.6 s (measured on a recorded gel).
TAIL_US, TAIL_SHARE = 150_000, 0.3

# Least change of displacement over a pitch, rms, as a share of the shift that all markers share.
# Trackers err by hundredths of it (0.02 under a plate that shifts by 15 px; touches reach 0.8).
COMMON_SHARE = 0.1

NOISE_FACTOR = 6.0  # Times the strength at rest that a touch must exceed.

# Largest threshold, in thresholds of a sensor without noise: a slow press is no noise, however long
# the rest has followed it (markers that drift by 0.3 px reach 4.4; with 4 and 7 a release, or a
# press of 3 s, is told wrongly; simulated).
MOST_FLOORS = 5.0

SETTLE_US = 500_000  # Time after a release within which the rest follows whatever falls, us.
# Time from the first frame on that is rest, us, unless the skin moves from the second time on by
# this share of the threshold (a camera's burst is over by then, a press is not).
START_US, LATE_US, LATE_SHARE = 100_000, 80_000, 0.5
RESTING_US = 2_000_000  # Time constant of the rest otherwise, us.

# Strength against the calibrated rest up to which that holds (a real gel, which creeps,
# rested at 0.009 to 0.031 from where it was calibrated; its presses reach 0.09 and more).
START_STRENGTH = 0.05


@dataclass(slots=True)
class _Settling:
    """The rest after a touch: what it was before, and how near to it the skin has come."""

    t_us: int
    former_zero: FloatArray
    lowest: float


class TouchDetector:
    """Finds touches in marker frames, one by one and causally.

    Frames come in order of time. Markers whose places are not finite move as their neighbours do.

    Example:
        >>> detector = TouchDetector(calibration.reference_px)  # doctest: +SKIP
        >>> touches = [t for f in frames if (t := detector.update(f))]  # doctest: +SKIP
    """

    def __init__(self, reference_px: FloatArray, unit: str = "px") -> None:
        """Start at rest.

        Args:
            reference_px: ``(m, 2)`` markers at rest, in that unit.
            unit: ``px`` for markers that an event camera sees, which sees no motion's beginning
                that follows another; ``mm`` for a sensor that sees places. Every length of the
                touches is in it.

        Raises:
            ConfigError: Too few markers.
        """
        self._reference = np.asarray(reference_px, np.float64)
        pitch = marker_pitch_px(self._reference)
        self._scatter = SCATTER_PX if unit == "px" else SCATTER_SHARE * pitch
        self._common = COMMON_SHARE / pitch
        self._gradient = GradientOperator(self._reference)
        self._floor = self._scatter * self._gradient.noise_gain() / np.sqrt(2)
        self._patches = PatchEstimator(self._reference)
        self._gauge = FieldGauge(self._reference, self._scatter)
        self._lost = LostMarkers(self._reference)
        self._sees_changes = unit == "px"
        self.reset()

    def reset(self) -> None:
        """Forget everything: the markers are at the calibrated rest."""
        self._open: OpenTouch | None = None
        self._lost.reset()
        self._zero = np.zeros_like(self._reference)
        self._moved = self._tracked = np.zeros_like(self._reference)
        self._start = self._zero, self._zero  # First displacements, and those after 80 ms.
        self._lost_before = self._lost.lost
        self._rest_strength = 0.0
        self._first_us: int | None = None
        self._last_us: int | None = None
        self._former = -TAIL_US, 0.0  # End of the last touch, us, and its peak strength.
        self._settling: _Settling | None = None
        self._memory = OnsetMemory(len(self._reference), self._sees_changes)

    @property
    def touching(self) -> bool:
        """True while a touch is open."""
        return self._open is not None

    @property
    def displacement_px(self) -> FloatArray:
        """``(m, 2)`` markers of the last frame from their rest; lost ones as their neighbours."""
        return self._moved - self._zero

    @property
    def tracked_px(self) -> FloatArray:
        """``(m, 2)`` the same, but of a touch's markers only those lost before it as neighbours.

        The rim of a small contact strains the skin so much that its markers look lost, and are
        found again by and by: they jump by pixels. Whoever watches motions wants no jumps.
        """
        return self._tracked - self._zero

    @property
    def patch(self) -> Patch | None:
        """Where the open touch is, at its peak so far; None while nothing touches."""
        return None if self._open is None else self._patches.patch(self._open.field)

    @property
    def threshold(self) -> float:
        """Strength of the gradient at which a touch begins now."""
        return min(max(self._floor, NOISE_FACTOR * self._rest_strength), MOST_FLOORS * self._floor)

    def update(self, frame: MarkerFrame) -> Touch | None:
        """Take in a frame and return the touch that it ends, if any."""
        seen = self._lost.filled(frame.detected_px - self._reference, self._zero, self._moved)
        moved = self._repaired(seen)
        self._moved = self._tracked = moved
        if moved is not seen and self._open is not None:
            lost = (self._lost.lost & self._lost_before)[:, None]
            self._tracked = np.where(lost, moved, seen)
        self._begin(frame.t_us, moved)
        elapsed_us = 0 if self._last_us is None else frame.t_us - self._last_us
        self._last_us = frame.t_us
        if self._open is not None:
            better_us = self._memory.refine(frame.t_us, moved)
            self._open.begin_us = self._open.begin_us if better_us is None else better_us
            return self._follow(self._open, frame.t_us, moved)
        settling = self._settle(frame.t_us, moved)
        self._memory.add(frame.t_us, moved)
        strength = self._gradient.strength_of(moved - self._zero)
        if strength > self.threshold and not settling:
            begin_us, threshold = self._memory.notice(moved - self._zero), self.threshold
            home = CalibratedRest(self._gradient, self._zero, moved - self._zero)
            self._open = OpenTouch(begin_us, threshold, Release(), home, self.tracked_px)
            return self._follow(self._open, frame.t_us, moved)
        self._rest(elapsed_us, moved, strength)
        return None

    def _begin(self, t_us: int, moved: FloatArray) -> None:
        """Follow the rest in the first frames; a skin that still moves then is pressed."""
        if self._first_us is None:
            self._first_us, self._start = t_us, (moved, moved)
        elapsed_us, (first, late) = t_us - self._first_us, self._start
        if elapsed_us < START_US:
            self._start = first, moved if elapsed_us < LATE_US else late
            if self._gradient.strength_of(moved) < START_STRENGTH:
                self._zero = moved
        elif late is not first:
            if self._gradient.strength_of(moved - late) > LATE_SHARE * self._floor:
                self._zero = first
            self._start = first, first

    def finish(self) -> Touch | None:
        """Return the touch that is still open at the end, without an end."""
        touch, self._open = self._open, None
        if touch is None or touch.home.was_return(touch.strength):
            return None
        return self._told(touch, None)

    def _told(self, touch: OpenTouch, end_us: int | None) -> Touch | None:
        before_us, before = self._former
        tail = touch.begin_us - before_us < TAIL_US and touch.strength < TAIL_SHARE * before
        # Trackers err in a shift that all markers share.
        shifted = touch.strength < self._common * float(np.hypot(*np.median(touch.field, axis=0)))
        if tail or shifted or not touch.spreads:
            return None
        if end_us is not None:
            self._former = end_us, touch.strength
        patch = self._patches.patch(touch.field)
        return Touch(
            begin_us=touch.begin_us,
            end_us=end_us,
            peak_us=touch.peak_us,
            peak_strength=touch.strength,
            peak_displacement_px=touch.largest_px,
            place_px=patch.place,
            area_px2=patch.area,
            outline_px=patch.outline,
            field=self._gauge.measure(touch.field),
        )

    def _repaired(self, moved: FloatArray) -> FloatArray:
        """Replace lost markers; one that is lost or found at rest is at rest where it is now."""
        before = self._lost.lost
        repaired = self._lost.repaired(moved)
        changed = before != self._lost.lost
        if self._open is None:
            self._lost_before = self._lost.lost
            if changed.any():
                self._zero = np.where(changed[:, None], repaired, self._zero)
                self._memory.clear()
        return repaired

    def _follow(self, touch: OpenTouch, t_us: int, moved: FloatArray) -> Touch | None:
        """Measure an open touch and return it if it is over."""
        away = moved - self._zero
        strength = self._gradient.strength_of(away)
        largest_px, spread = spread_of(away, SPREAD_MARKERS)
        touch.largest_px = max(touch.largest_px, largest_px)
        touch.spread = max(touch.spread, spread)
        if strength > touch.strength:
            touch.strength, touch.peak_us, touch.field = strength, t_us, self.tracked_px
            touch.spreads = spreads(away)
        end_us = touch.release.update(t_us, self._left(touch, spread, strength))
        if end_us is not None:
            self._settling = _Settling(t_us, self._zero, strength)
            return self._closed(touch, end_us, moved)
        back_us = touch.home.update(t_us, moved)
        if back_us is None:
            return None
        ended = self._closed(touch, back_us, moved)
        return None if touch.home.was_return(touch.strength) else ended

    def _closed(self, touch: OpenTouch, end_us: int, moved: FloatArray) -> Touch | None:
        """Return a touch that is over, None of noise; where the skin is now, is its rest."""
        told = self._told(touch, end_us)
        self._open, self._zero = None, moved
        self._memory.clear()
        return told

    def _left(self, touch: OpenTouch, spread: float, strength: float) -> float:
        """Return the share of the touch's peak that is left, in strength or in spread.

        A few markers that are lost in a release strain the field for ever; most are back. A faint
        touch is over where it would not begin.
        """
        left = strength / max(touch.strength, 1e-12)
        if self._tracked is not self._moved:  # some markers look lost only
            strength = max(strength, self._gradient.strength_of(self.tracked_px))
        faint = strength / (FAINT_SHARE * touch.threshold)
        if faint < 1.0:
            left = min(left, END_SHARE * faint)
        if touch.spread < SPREAD_FACTOR * self._scatter:
            return left
        return min(left, END_SHARE / SPREAD_SHARE * spread / touch.spread)

    def _settle(self, t_us: int, moved: FloatArray) -> bool:
        """Right after a release the rest is wherever the skin falls back to.

        Returns:
            Whether it still falls back: marker by marker, so that its shape changes on the way.
        """
        settling = self._settling
        if settling is None:
            return False
        strength = self._gradient.strength_of(moved - settling.former_zero)
        falls_back = strength <= settling.lowest + self.threshold
        if strength <= settling.lowest:
            settling.lowest, self._zero = strength, moved
        if t_us - settling.t_us > SETTLE_US:
            self._settling = None
            if falls_back:
                self._zero = moved
        return falls_back

    def _rest(self, elapsed_us: int, moved: FloatArray, strength: float) -> None:
        """Let the rest and its noise follow what is seen while nothing touches."""
        share = -np.expm1(-elapsed_us / RESTING_US)
        self._zero = self._zero + share * (moved - self._zero)
        self._rest_strength += share * (strength - self._rest_strength)
