"""Touches with their slips, from one stream of marker frames."""

from dataclasses import dataclass

import numpy as np

from spikingtac.errors import require_type
from spikingtac.touch.detector import TouchDetector
from spikingtac.touch.slip.monitor import Slip, SlipMonitor, SlipState
from spikingtac.touch.touch import Touch
from spikingtac.tracks import Tracks
from spikingtac.tracks.comparison import LOADED
from spikingtac.types import FloatArray, MarkerFrame


@dataclass(frozen=True, slots=True)
class HeldTouch:
    """A touch and how it held.

    Attributes:
        touch: The touch.
        slips: Its slips in order; None where the frames were too far apart to tell any.
    """

    touch: Touch
    slips: tuple[Slip, ...] | None


class HeldTouchDetector:
    """Finds touches and their slips, causally.

    Frames come in order of time; one of an earlier time begins anew.

    Example:
        >>> detector = HeldTouchDetector(calibration.reference_px)  # doctest: +SKIP
        >>> held = [one for frame in frames if (one := detector.update(frame))]  # doctest: +SKIP

    Attributes:
        touches: The detector of touches within.
    """

    def __init__(self, reference: FloatArray, unit: str = "px") -> None:
        """Start at rest.

        Args:
            reference: ``(m, 2)`` markers at rest, in that unit.
            unit: As of :class:`~spikingtac.touch.detector.TouchDetector`.

        Raises:
            ConfigError: Too few markers.
        """
        self.touches = TouchDetector(reference, unit)
        self._monitor = SlipMonitor(reference)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the markers are at the calibrated rest."""
        self.touches.reset()
        self._monitor.reset()
        self._slips: list[Slip] = []
        self._told = False
        self._last_us: int | None = None

    @property
    def slip(self) -> SlipState | None:
        """How the open touch holds; None while nothing is told of it (:class:`SlipMonitor`)."""
        return self._monitor.state

    def update(self, frame: MarkerFrame) -> HeldTouch | None:
        """Take in a frame and return the touch that it ends, if any."""
        if self._last_us is not None and frame.t_us < self._last_us:
            ended = self.finish()
            self.reset()
            self.update(frame)
            return ended
        touch = self.touches.update(frame)
        moved, touching = self.touches.tracked_px, self.touches.touching
        slip = self._monitor.update(frame.t_us, moved, touching)
        self._slips += [] if slip is None else [slip]
        self._last_us = frame.t_us
        if touch is not None:
            return self._held(touch)
        if not touching:  # nothing was touched, or what looked like a touch was none
            self._slips, self._told = [], False
        self._told = self._told or (touching and self._monitor.tells)
        return None

    def finish(self) -> HeldTouch | None:
        """Return the touch that is still open at the end, without an end."""
        touch = self.touches.finish()
        slip = self._monitor.finish(self._last_us or 0)
        self._slips += [] if slip is None else [slip]
        return None if touch is None else self._held(touch)

    def _held(self, touch: Touch) -> HeldTouch:
        held = HeldTouch(touch, tuple(self._slips) if self._told else None)
        self._slips, self._told = [], False
        return held


def find_touches(tracks: Tracks) -> list[HeldTouch]:
    """Return the touches of a recording that was tracked, each with its slips.

    Args:
        tracks: Of one sensor.

    Raises:
        ConfigError: Too few markers, or something else than tracks.

    Example:
        >>> for held in find_touches(tracks):  # doctest: +SKIP
        ...     print(held.touch.begin_us, held.touch.place_px)
    """
    require_type(tracks, Tracks, LOADED)
    detector = HeldTouchDetector(tracks.reference_px.astype(np.float64))
    found = [detector.update(frame) for frame in tracks.frames()]
    return [held for held in (*found, detector.finish()) if held is not None]


def find_slip(tracks: Tracks) -> list[Slip]:
    """Return the slips of a recording that was tracked, in order; see :func:`find_touches`."""
    return [slip for held in find_touches(tracks) for slip in held.slips or ()]
