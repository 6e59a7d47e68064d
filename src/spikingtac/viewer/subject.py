"""What is looked at: a source of events, how it is tracked, and the truth where it is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.source import EventSource
from spikingtac.live.playback import ContactWatch
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.types import Calibration


class Truth(Protocol):
    """Knows where the markers really are."""

    def at(self, t_us: int) -> NDArray[np.float64] | None:
        """Return ``(m, 2)`` true positions, px, or None outside the known stretch."""
        ...


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Everything that a session needs to show one sensor.

    Attributes:
        label: What the page is titled.
        source: The events.
        calibration: Where the markers rest.
        config: Settings of the tracker; those with metadata become controls.
        make_tracker: Builds a tracker from settings.
        make_watch: Builds the contact detector, or returns None.
        truth: True positions, or None.
        rate_hz: Estimates per second.
        simulated: True where the events come from the digital twin.
        ends: True where the source ends by itself, so that its length is known at once.
    """

    label: str
    source: EventSource
    calibration: Calibration
    config: Any
    make_tracker: Callable[[Any], MarkerTracker]
    make_watch: Callable[[], ContactWatch | None] = field(default=lambda: None)
    truth: Truth | None = None
    rate_hz: float = 1_000.0
    simulated: bool = False
    ends: bool = True


class SampledTruth:
    """True positions sampled at given times, joined by straight lines."""

    def __init__(self, t_us: NDArray[np.int64], marker_px: NDArray[np.floating]) -> None:
        """Keep the samples.

        Args:
            t_us: ``(n,)`` increasing times, us.
            marker_px: ``(n, m, 2)`` positions, px.
        """
        self._t_us, self._marker_px = t_us, marker_px

    def at(self, t_us: int) -> NDArray[np.float64] | None:
        """Return ``(m, 2)`` positions at a time, or None outside the samples."""
        if not len(self._t_us) or not self._t_us[0] <= t_us <= self._t_us[-1]:
            return None
        after = min(int(np.searchsorted(self._t_us, t_us, side="right")), len(self._t_us) - 1)
        before = max(after - 1, 0)
        span_us = max(int(self._t_us[after] - self._t_us[before]), 1)
        share = (t_us - int(self._t_us[before])) / span_us
        first, last = (self._marker_px[index].astype(np.float64) for index in (before, after))
        return first + share * (last - first)
