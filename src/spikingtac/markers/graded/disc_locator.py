"""Locate markers by fitting discs to the graded map: accurate and robust (preset ``default``)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.disc_fit import fit_discs_kernel, round_outline
from spikingtac.markers.graded.fit_window import fit_window
from spikingtac.markers.graded.initial_map import painted_graded_map
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.state_map.two_threads import MANY_MARKERS, divide, worth_dividing

LARGEST_FALL = 0.05
"""Fall of the agreement that tells of a marker that snapped away (ours: a snap of 14 px costs 0.15
within 3 ms; 0.05 to 0.10 are equally good on a small simulated sensor)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscLocatorConfig:
    """Settings of the disc fit.

    Attributes:
        iterations: Gauss-Newton steps per marker and estimate at most (ours: two suffice on
            average, a sudden release takes more).
        reach_px: Farthest from the radius that a fit reads, px (ours); where the edge is flat it
            reads nothing, however far this is.
        grid_weight: Pull towards the neighbours' prediction, as a share of the fit's own curvature
            (ours: a strong pull smooths real deformation away).
        outline_per_s: Rate at which the outline follows what the fit sees, 1/s (ours: indentation
            and strain take tens of ms).
        outline_share: Largest change of the outline, as a share of the radius (ours).
    """

    iterations: int = field(default=3, metadata={"range": (1, 8)})
    reach_px: float = field(default=6.0, metadata={"range": (1.0, 6.0)})
    grid_weight: float = field(default=0.01, metadata={"range": (0.0, 0.5)})
    outline_per_s: float = field(default=150.0, metadata={"range": (0.0, 400.0), "unit": "1/s"})
    outline_share: float = 0.3

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ConfigError(f"iterations is {self.iterations}, it must be at least 1")
        if not self.reach_px > 0.0:
            raise ConfigError(f"reach_px is {self.reach_px}, it must be positive")
        if self.grid_weight < 0.0:
            raise ConfigError(f"grid_weight is {self.grid_weight}, it must not be negative")


class DiscLocator:
    """Robust Gauss-Newton fits, all markers at once; of many markers by two threads."""

    def __init__(self, config: DiscLocatorConfig, calibration: Calibration) -> None:
        """Choose the pixels and the profile for a sensor's markers."""
        self._config = config
        self._radius_px = calibration.radius_px.astype(np.float64)
        self.outline_px = round_outline(self._radius_px)
        window = fit_window(
            appearance_of(calibration).profiles, calibration.size[0], config.reach_px
        )
        self._pixels, self._curves = window.pixels, window.curves(config.iterations)
        self._agreement = np.ones(len(calibration.radius_px))
        self._divided = worth_dividing(len(calibration.radius_px), MANY_MARKERS)

    @property
    def needs_expectation(self) -> bool:
        """True where the neighbours' prediction takes part in the estimate."""
        return self._config.grid_weight > 0.0

    @property
    def largest_fall(self) -> float:
        """By how much the agreement of a fit that follows its marker falls at most."""
        return LARGEST_FALL

    def locate(
        self,
        state_map: GradedStateMap,
        predicted_px: NDArray[np.float64],
        expected_px: NDArray[np.float64] | None,
        dt_s: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``(m, 2)`` centres, px, and ``(m,)`` agreement with the map, 0 to 1."""
        config = self._config
        center_px = predicted_px.copy()
        prior = (predicted_px, 0.0) if expected_px is None else (expected_px, config.grid_weight)
        gain = 1.0 - math.exp(-dt_s * config.outline_per_s)
        if self._divided:
            divide(
                len(center_px),
                lambda some: self._fit_some(state_map.padded, center_px, prior, gain, some),
            )
        else:
            fit_discs_kernel(
                state_map.padded,
                center_px,
                self.outline_px,
                self._pixels,
                self._curves,
                prior,
                (self._radius_px, config.outline_share, gain),
                self._agreement,
            )
        return center_px, self._agreement

    def _fit_some(
        self,
        padded: NDArray[np.float32],
        center_px: NDArray[np.float64],
        prior: tuple[NDArray[np.float64], float],
        gain: float,
        some: slice,
    ) -> None:
        *of_each, iterations = self._curves
        fit_discs_kernel(
            padded,
            center_px[some],
            self.outline_px[some],
            self._pixels,
            (*(values[some] for values in of_each), iterations),
            (prior[0][some], prior[1]),
            (self._radius_px[some], self._config.outline_share, gain),
            self._agreement[some],
        )

    def initial_map(self, calibration: Calibration) -> GradedStateMap:
        """Return the graded map of the sensor at rest."""
        return painted_graded_map(calibration, appearance_of(calibration))

    def reset(self) -> None:
        """Forget the outlines that strain and indentation gave the discs."""
        self.outline_px[:] = round_outline(self._radius_px)
