"""What is viewed: a source of events, how it is tracked, and the truth where it is known."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector
from spikingtac.events.source import EventSource
from spikingtac.markers.registry import MarkerTracker

if TYPE_CHECKING:  # both need every kernel of the calibration and of touch
    from spikingtac.viewer.calibrating import CalibrationDesk
    from spikingtac.viewer.felt import FeltLayer

BEYOND_US = 2_000  # How far the last line is prolonged: one step of a simulation at 500 Hz.


@dataclass(frozen=True, kw_only=True)
class ViewSource:
    """Everything that a session needs to show one sensor.

    Attributes:
        label: What the page is titled.
        source: The events.
        calibration: Where the markers rest.
        config: Settings of the tracker; those with metadata become controls.
        make_tracker: Builds a tracker from settings.
        make_detector: Builds the contact detector, or returns None.
        truth: True positions, or None.
        rate_hz: Estimates per second.
        simulated: True where the events come from the digital twin.
        ends: True where the source ends by itself, so that its length is known at once.
        felt: Tells force, patch and vibration where a force model was given, or None.
        desk: Where a page calibrates a sensor that has no calibration yet, or None.
        calibrated_by: What the calibration is: a file's name, or where a scene brings it.
        own_calibration: True where the calibration is the sensor's by its making, as a scene's is;
            any other is compared with the events.
    """

    label: str
    source: EventSource
    calibration: Calibration
    config: Any
    make_tracker: Callable[[Any], MarkerTracker]
    make_detector: Callable[[], ContactDetector | None] = field(default=lambda: None)
    truth: SampledTruth | None = None
    rate_hz: float = 1_000.0
    simulated: bool = False
    ends: bool = True
    felt: FeltLayer | None = None
    desk: CalibrationDesk | None = None
    calibrated_by: str = ""
    own_calibration: bool = False

    def close(self) -> None:
        """End a source that runs by itself, as a camera and a scene do."""
        end = getattr(self.source, "close", None)
        if end is not None:
            end()


class SampledTruth:
    """True positions sampled at given times, joined by straight lines.

    A simulation that goes on appends to it; just beyond the last sample the line is prolonged.

    Args:
        t_us: Increasing times, us.
        marker_px: ``(m, 2)`` positions at each of them, px.
    """

    def __init__(
        self, t_us: Iterable[int] = (), marker_px: Iterable[NDArray[np.floating]] = ()
    ) -> None:
        self._t_us, self._marker_px = list(t_us), list(marker_px)

    def append(self, t_us: NDArray[np.int64], marker_px: NDArray[np.floating]) -> None:
        """Add samples, later than those that are known."""
        self._t_us.extend(t_us.tolist())
        self._marker_px.extend(marker_px)

    def at(self, t_us: int) -> NDArray[np.float64] | None:
        """Return ``(m, 2)`` positions at a time, or None where they are not known."""
        times_us = self._t_us
        if len(times_us) < 2 or not times_us[0] <= t_us <= times_us[-1] + BEYOND_US:
            return None
        after = min(max(bisect_right(times_us, t_us), 1), len(times_us) - 1)
        start_us, end_us = times_us[after - 1], times_us[after]
        first, last = (self._marker_px[row].astype(np.float64) for row in (after - 1, after))
        return first + (t_us - start_us) / (end_us - start_us) * (last - first)
