"""The project's most accurate tracker: discs fitted to the graded map, one screen.

Graded map -> robust disc fit from the predicted position -> Kalman filter -> lag correction ->
the map leaks towards the discs. Lost markers are predicted from their neighbours and found again
by a full-frame detection (:mod:`spikingtac.markers.custody`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.markers.custody import Custody, CustodyConfig
from spikingtac.markers.disc_fit import fit_discs_kernel, fit_window, leak_to_discs_kernel
from spikingtac.markers.events_kept import EventsKept
from spikingtac.markers.hysteresis import NoLaw, OutputLaw
from spikingtac.markers.motion_filter import MotionFilter
from spikingtac.markers.profile import TABLE_STEP_PX
from spikingtac.markers.start import LAG_DEFAULT_US, painted_graded_map, profile_of
from spikingtac.types import Calibration, EventPacket, MarkerFrame

LEAK_GROUPS = 4
"""The leak visits every fourth marker per estimate, in turn: the same effect, a quarter of the
cost."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscTrackerConfig:
    """What the disc tracker can be told.

    Attributes:
        iterations: Gauss-Newton steps per marker and estimate at most (ours: two suffice on
            average, a sudden release takes more).
        reach_px: Half the width of the annulus that a fit reads, px (ours).
        grid_weight: Pull towards the neighbours' prediction, as a share of the fit's own curvature
            (ours: a strong pull smooths real deformation away).
        leak_per_s: Rate at which map pixels give up their disagreement with the fitted disc, 1/s.
        leak_tolerance: Disagreement that is left alone: one step of a typical sensor.
        lag_us: Delay of the events behind the motion, us; None takes the calibration's.
        adapt_to_loss: Whether steps grow when fewer events arrive than the motion asks for.
        custody: When a marker counts as lost, and how it is found again.
    """

    iterations: int = 3
    reach_px: float = 3.5
    grid_weight: float = 0.03
    leak_per_s: float = 10.0
    leak_tolerance: float = 0.14
    lag_us: float | None = None
    adapt_to_loss: bool = True
    custody: CustodyConfig = field(default_factory=CustodyConfig)

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ConfigError(f"iterations is {self.iterations}, it must be at least 1")
        if not self.reach_px > 0.0:
            raise ConfigError(f"reach_px is {self.reach_px}, it must be positive")
        for name in ("grid_weight", "leak_per_s", "leak_tolerance"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"{name} is {getattr(self, name)}, it must not be negative")


class DiscTracker:
    """Follows markers by fitting discs to the graded state map.

    Example:
        >>> from spikingtac.types import Calibration
        >>> calibration = Calibration(
        ...     reference_px=np.array([[20.0, 20.0]]), radius_px=np.array([7.0]),
        ...     grid=(1, 1), size=(40, 40))
        >>> frame = DiscTracker(DiscTrackerConfig(), calibration).estimate(0)
        >>> bool(np.hypot(*(frame.detected_px[0] - 20.0)) < 0.01)
        True
    """

    def __init__(
        self, config: DiscTrackerConfig, calibration: Calibration, law: OutputLaw | None = None
    ) -> None:
        """Paint the map from the calibration, so that no bootstrap slides are needed.

        Args:
            config: What the tracker can be told.
            calibration: Where the markers rest and how they look.
            law: From detected to given position; None gives out what was detected.
        """
        self._config = config
        self._calibration = calibration
        self._law = law or NoLaw()
        self._profile = profile_of(calibration)
        self._map = painted_graded_map(calibration, self._profile)
        self._window = fit_window(
            self._profile, calibration.radius_px, self._map.padded.shape[1], config.reach_px
        )
        lag_us = config.lag_us if config.lag_us is not None else calibration.lag_us
        self._lag_s = (LAG_DEFAULT_US if lag_us is None else lag_us) * 1e-6
        self._start()

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time.

        Raises:
            ConfigError: The recording comes from a sensor of another size.
        """
        self._map.absorb(packet)
        self._events += len(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        dt_s = 0.0 if self._t_us is None else (t_us - self._t_us) * 1e-6
        self._t_us = t_us
        predicted_px = self._filter.predict(dt_s)
        fitted_px = self._fit(predicted_px)
        held = self._custody.judge(t_us, fitted_px, self._agreement, self._map.values)
        self._filter.update(fitted_px, held)
        found = self._custody.moved
        if found.any():
            self._filter.place(found, self._custody.position_px[found])
        if self._config.adapt_to_loss:
            self._adapt(dt_s)
        self._leak(dt_s)
        return self._frame(t_us, held)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self._map.reset()
        self._law.reset()
        self._start()

    def _start(self) -> None:
        calibration = self._calibration
        self._t_us: int | None = None
        self._events = 0
        self._turn = 0
        self._filter = MotionFilter(calibration.reference_px)
        self._custody = Custody(self._config.custody, calibration)
        self._kept = EventsKept(calibration)
        self._agreement = np.ones(len(calibration.reference_px))

    def _fit(self, predicted_px: NDArray[np.float64]) -> NDArray[np.float64]:
        fitted_px = predicted_px.copy()
        window = self._window
        fit_discs_kernel(
            self._map.padded,
            fitted_px,
            self._calibration.radius_px,
            (window.offset, window.dx, window.dy),
            window.coefficients,
            window.reach_px,
            self._config.iterations,
            self._custody.expected_px(predicted_px),
            self._config.grid_weight,
            self._agreement,
        )
        return fitted_px

    def _adapt(self, dt_s: float) -> None:
        share = self._kept.update(self._events, self._filter.velocity_px_s, dt_s)
        self._events = 0
        if share is not None:
            self._map.set_events_kept(share)

    def _leak(self, dt_s: float) -> None:
        share = 1.0 - np.exp(-self._config.leak_per_s * dt_s * LEAK_GROUPS)
        if share <= 0.0:
            return
        self._turn = (self._turn + 1) % LEAK_GROUPS
        reach_px = self._profile.reach_px
        leak_to_discs_kernel(
            self._map.padded,
            self._map.memory,
            self._filter.position_px[self._turn :: LEAK_GROUPS],
            self._calibration.radius_px[self._turn :: LEAK_GROUPS],
            self._profile.tables[0],
            (reach_px, 1.0 / TABLE_STEP_PX, self._config.reach_px),
            self._config.leak_tolerance,
            share,
        )

    def _frame(self, t_us: int, held: NDArray[np.bool_]) -> MarkerFrame:
        detected_px = self._filter.position_px + self._lag_s * self._filter.velocity_px_s
        reference_px = self._calibration.reference_px
        position_px = self._law.update(detected_px, reference_px)
        return MarkerFrame(
            t_us=t_us,
            detected_px=detected_px,
            position_px=position_px,
            displacement_px=position_px - reference_px,
            held=held.copy(),
            confidence=np.where(held, 0.0, np.clip(self._agreement, 0.0, 1.0)),
        )
