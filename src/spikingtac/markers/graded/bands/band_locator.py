"""Locate markers from the levels at which pixels fired: for sensors whose OFF events are rare."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.bands.band_fit import fit_bands_kernel
from spikingtac.markers.graded.bands.band_recovery import (
    RecoveryTurns,
    recover_levels_kernel,
    recovering_px,
)
from spikingtac.markers.graded.disc_fit import round_outline
from spikingtac.markers.graded.initial_map import painted_band_map
from spikingtac.markers.graded.profile_tables import profile_tables
from spikingtac.markers.maintenance_config import MaintenanceConfig
from spikingtac.state_map.bands import BandStateMap
from spikingtac.state_map.graded import GradedStateMap

MOST_VARIANCES = (0.05, 1.0e4)
"""Variances of place (px^2) and speed (px^2/s^2) that a resting marker is believed to have at most:
a motion that begins within one estimate."""

LONGEST_PERIOD_US = 1_000
"""Longest time between estimates: over longer ones the motion's own prediction, which is the prior,
strays (recorded gel, every 4 ms: 0.85 px pressed instead of 0.80)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BandLocatorConfig:
    """Settings of the band fit.

    Attributes:
        iterations: Gauss-Newton steps per marker and estimate at most (ours).
        acceleration_px2_s3: Noise density of a marker's acceleration, px^2/s^3 (ours).
        stop_s: Time in which the speed of a marker fades near which no pixel fires, s (ours).
        band_weight: Weight of a pixel that did not fire, over that of one that did (ours).
        most_gain: Largest share of a level's disagreement that one estimate corrects (ours).
        growth_share: How much discs grow under load, as a share of their radius, on sensors whose
            pixels recover; on others the radius stays (8 % by the events around the markers of the
            recorded gel; on its first two presses they come from 1.12 to 0.97 px of the reference).
        growth_s: Time in which a moving disc returns to its radius at rest, s (ours: 0.1 to 1 are
            alike there).
        far_px: A marker that is predicted farther away than this was found elsewhere, px (ours).
    """

    iterations: int = field(default=3, metadata={"range": (1, 8)})
    acceleration_px2_s3: float = field(default=5.0e5, metadata={"range": (1.0e3, 1.0e7)})
    stop_s: float = 3.0e-3
    band_weight: float = field(default=0.4, metadata={"range": (0.0, 1.0)})
    most_gain: float = field(default=0.3, metadata={"range": (0.0, 1.0)})
    growth_share: float = field(default=0.1, metadata={"range": (0.0, 0.3)})
    growth_s: float = field(default=0.3, metadata={"range": (0.01, 10.0), "unit": "s"})
    far_px: float = 2.0

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ConfigError(f"iterations is {self.iterations}, it must be at least 1")
        if not (self.acceleration_px2_s3 > 0.0 and self.stop_s > 0.0 and self.far_px > 0.0):
            raise ConfigError("acceleration_px2_s3, stop_s and far_px must be positive")
        if not (0.0 <= self.growth_share <= 1.0 and self.growth_s > 0.0):
            raise ConfigError("growth_share must lie between 0 and 1, growth_s must be positive")
        if not (0.0 <= self.band_weight <= 1.0 and 0.0 <= self.most_gain <= 1.0):
            raise ConfigError("band_weight and most_gain must lie between 0 and 1")


class BandLocator:
    """Maximum a posteriori fits to a :class:`BandStateMap`, all markers at once."""

    def __init__(self, config: BandLocatorConfig, calibration: Calibration) -> None:
        """Tabulate the profiles of a sensor's markers."""
        self._radius_px = calibration.radius_px.astype(np.float64)
        self._start_px = calibration.reference_px.astype(np.float64)
        self.outline_px = round_outline(self._radius_px)
        tables = profile_tables(appearance_of(calibration).profiles)
        self._discs = self._radius_px, tables.values, tables.reach_px
        recovers = calibration.recovery_s is not None
        growth = (config.growth_share if recovers else 0.0), config.growth_s
        self._filtering = config.acceleration_px2_s3, config.stop_s, *MOST_VARIANCES, *growth
        self._fitting = config.band_weight, config.most_gain, config.iterations
        self._far_px = config.far_px
        self._recovery_s = calibration.recovery_s
        self._within_px = recovering_px(self._start_px, self._radius_px, tables.reach_px)
        self.reset()

    @property
    def needs_expectation(self) -> bool:
        """False: the motion's own prediction is the prior."""
        return False

    @property
    def largest_fall(self) -> float:
        """Any: a band map does not leak."""
        return float("inf")

    def locate(
        self,
        state_map: GradedStateMap,
        predicted_px: NDArray[np.float64],
        expected_px: NDArray[np.float64] | None,
        dt_s: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ``(m, 2)`` centres, px, and ``(m,)`` agreement with the map, 0 to 1.

        Raises:
            ConfigError: The map is no :class:`BandStateMap`.
        """
        if not isinstance(state_map, BandStateMap):
            raise ConfigError("the band fit reads a BandStateMap; make one from the calibration")
        apart_px = np.linalg.norm(predicted_px - self._motion[:, :2], axis=1)
        placed = apart_px > self._far_px
        if placed.any():
            self._motion[placed] = _at_rest(predicted_px[placed], self._radius_px[placed])
        maps = (
            state_map.memory,
            state_map.variance,
            state_map.fired,
            state_map.signed_steps,
            state_map.turn,
            state_map.padded,
        )
        settings = self._filtering, self._fitting
        fit_bands_kernel(maps, self._motion, dt_s, self._discs, *settings, self._agreement)
        state_map.turn += 1
        center_px = self._motion[:, :2].copy()
        if self._recovery is not None:
            share = self._recovery.shares(dt_s)
            levels = state_map.padded, state_map.memory
            discs = np.ascontiguousarray(self._motion[:, 7]), *self._discs[1:]
            recover_levels_kernel(*levels, center_px, discs, self._within_px, share)
        return center_px, self._agreement

    def initial_map(self, calibration: Calibration) -> BandStateMap:
        """Return the band map of the sensor at rest."""
        return painted_band_map(calibration, appearance_of(calibration))

    def reset(self) -> None:
        """Forget where the markers went."""
        markers, recovery_s = len(self._start_px), self._recovery_s
        self._motion = _at_rest(self._start_px, self._radius_px)
        self._agreement = np.ones(markers)
        self._recovery = RecoveryTurns(markers, recovery_s) if recovery_s else None


def _at_rest(
    position_px: NDArray[np.float64], radius_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``(m, 9)`` states of markers that rest somewhere, nothing being known of a motion."""
    motion = np.zeros((len(position_px), 9))
    motion[:, :2], motion[:, 7] = position_px, radius_px
    motion[:, 4], motion[:, 6] = MOST_VARIANCES
    return motion


def banded(calibration: Calibration) -> Calibration:
    """Return a calibration with the steps that the band fit should have."""
    on, off = calibration.band_scale_on, calibration.band_scale_off
    if on is None or off is None:
        return calibration
    return calibration.with_steps_scaled(on, off)


def band_maintenance(maintenance: MaintenanceConfig) -> MaintenanceConfig:
    """Return what is left to do beside a band fit, which corrects the levels itself.

    Its steps do not grow when events are missing: what a motion asks for is counted for sensors
    whose pixels swing fully and whose OFF events are not rare. Nor does it stay behind its markers:
    what has not fired pulls at it only where the disc would leave the band.
    """
    return dataclasses.replace(
        maintenance,
        longest_period_us=min(maintenance.longest_period_us, LONGEST_PERIOD_US),
        leak_per_s=0.0,
        outline_return_per_s=0.0,
        adapt_to_loss=False,
        backlash=0.0,
        turn_backlash=0.0,
    )
