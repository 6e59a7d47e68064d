"""What is felt, for the page: force, patch, slip, vibration, from every estimate of a session."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.force.model import ForceModel, Wrench
from spikingtac.touch.slip.held import HeldTouchDetector
from spikingtac.touch.vibration import Spectrum, VibrationMonitor
from spikingtac.types import MarkerFrame

SPECTRUM_EVERY_US = 100_000  # How often the spectrum is made anew: faster than it can be read, us.
LARGEST_BINS = 250  # Bins of the spectrum that the page draws.


class FeltLayer:
    """Takes every estimate and gives the page the latest quantities of touch."""

    def __init__(
        self, reference_px: NDArray[np.float64], rate_hz: float, force: ForceModel
    ) -> None:
        """Begin at rest.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            rate_hz: Estimates per second.
            force: The force model of this sensor.

        Raises:
            ConfigError: The model is of another sensor.
        """
        force.require(reference_px, "px")
        self._reference, self._rate = reference_px, rate_hz
        self._force = force.estimator()
        self._touches = HeldTouchDetector(reference_px)
        self._restart()

    def _restart(self) -> None:
        self._force.reset()
        self._touches.reset()
        self._vibration = VibrationMonitor(self._rate)
        self._last_us = -1
        self._spectrum_us = 0
        self._wrench: Wrench | None = None
        self._spectrum: Spectrum | None = None

    def take(self, frame: MarkerFrame) -> None:
        """Take the next estimate; an earlier one begins anew."""
        if frame.t_us <= self._last_us:
            self._restart()
        self._last_us = frame.t_us
        moved = frame.detected_px - self._reference
        self._wrench = self._force.update(frame.t_us, moved)
        self._touches.update(frame)
        self._vibration.update(frame.t_us, moved)
        if frame.t_us - self._spectrum_us >= SPECTRUM_EVERY_US:
            self._spectrum_us = frame.t_us
            self._spectrum = self._vibration.spectrum()

    def shown(self) -> dict[str, Any]:
        """Return what the page shows, as JSON can hold it."""
        if self._wrench is None:
            return {}
        patch, line, slip = self._touches.touches.patch, self._spectrum, self._touches.slip
        return {
            "force_n": _rounded(self._wrench.force_n),
            "half_width_n": _rounded(self._wrench.half_width[:3]),
            "place_px": None if patch is None else _rounded(patch.place),
            "outline_px": None if patch is None else _rounded(patch.outline),
            "slip": None if slip is None else slip.phase,
            "sticking_share": None if slip is None else round(slip.sticking_share, 3),
            "line_hz": None if line is None else line.line_hz,
            "line_px": 0.0 if line is None else line.line_px,
            "spectrum_hz": 0.0 if line is None else float(line.frequency_hz[1]),
            "spectrum_px": [] if line is None else _rounded(line.amplitude_px[:LARGEST_BINS]),
        }


def _rounded(values: NDArray[np.float64]) -> Any:
    return np.round(values, 4).tolist()
