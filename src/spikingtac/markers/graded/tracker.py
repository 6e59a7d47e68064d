"""The project's own tracker, one screen: presets ``default`` and ``fast``.

Graded map -> locator (disc fit or centroid) from the predicted position -> Kalman filter -> lag
and backlash corrections -> shrinkage towards the neighbours (:mod:`spikingtac.markers.neighbours`).
In its own time it does the rest: lost markers are predicted from their neighbours and found again
(:mod:`spikingtac.markers.graded.track_management`), steps grow when events are lost
(:mod:`spikingtac.markers.graded.event_loss`), and the map leaks towards the fitted discs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HotPixelFilter
from spikingtac.markers.graded.appearance import appearance_of
from spikingtac.markers.graded.backlash import BacklashCompensation, crossing_px
from spikingtac.markers.graded.event_loss import EventLoss
from spikingtac.markers.graded.initial_map import LAG_DEFAULT_US, painted_levels
from spikingtac.markers.graded.locator import Locator
from spikingtac.markers.graded.map_leak import (
    LeakTolerances,
    ease_outlines_kernel,
    leak_to_discs_kernel,
    return_ground_kernel,
)
from spikingtac.markers.graded.profile_tables import profile_tables
from spikingtac.markers.graded.track_management import TrackManager
from spikingtac.markers.hysteresis import NoLaw, OutputLaw
from spikingtac.markers.maintenance_config import MaintenanceConfig
from spikingtac.markers.motion_filter import MotionFilter
from spikingtac.markers.periodic_task import PeriodicTask
from spikingtac.markers.released_zero import ReleasedZero
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket, MarkerFrame

AT_REST_PX_S = 3.0
"""Speed below which a marker counts as resting: creep, and the jitter of a filtered velocity."""

MOST_LEAKING = 32
"""Markers whose surroundings leak in one turn, where the turns can be as many: 0.2 ms (ours)."""

GROUND_TURNS = 64
"""Turns of the leak in which all rows of the ground are visited once: 5 rows of 320 (ours)."""

MOST_PARTS = 4
"""Turns that a period of the leak is divided into, for many markers (ours)."""


class GradedTracker:
    """Follows markers on the graded state map."""

    def __init__(
        self,
        locator: Locator,
        maintenance: MaintenanceConfig,
        calibration: Calibration,
        law: OutputLaw | None = None,
    ) -> None:
        """Paint the map from the calibration, so that no bootstrap slides are needed.

        Args:
            locator: Disc fit or centroid.
            maintenance: What the tracker does beside locating.
            calibration: Where the markers rest and how they look.
            law: From detected to given position; None gives out what was detected.
        """
        self._locator = locator
        self._maintenance_config = maintenance
        self._longest_us = maintenance.longest_period_us or math.inf
        self._calibration = calibration
        self._law = law or NoLaw()
        appearance = appearance_of(calibration)
        self._appearance = appearance
        self._hot = HotPixelFilter(calibration.hot_px, calibration.size)
        self._map = locator.initial_map(calibration)
        self._mean_step = 0.5 * (appearance.step_on + appearance.step_off)
        self._tables = profile_tables(appearance.profiles)
        self._crossings_px = crossing_px(calibration)
        self._ground_step = float(self._mean_step.mean())
        self._ground_px = calibration.radius_px + maintenance.leak_reach_px
        self._noise_px = maintenance.shrink_px + maintenance.shrink_crossings * self._crossings_px
        lag_us = maintenance.lag_us if maintenance.lag_us is not None else calibration.lag_us
        self._lag_s = (LAG_DEFAULT_US if lag_us is None else lag_us) * 1e-6
        self._start()

    @property
    def state_map(self) -> GradedStateMap:
        """The map as it stands; to be read, for a display or a picture, and not changed."""
        return self._map

    @property
    def _doubt(self) -> float:
        """How doubtful it is that the stream is whole, 0 to 1; 0 where it is taken to be."""
        return self._kept.doubt if self._maintenance_config.adapt_to_loss else 0.0

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time, however long it is.

        Raises:
            ConfigError: The recording comes from a sensor of another size.
        """
        packet = self._hot.kept(packet)
        # A fit looks for its disc nearby: where estimates are asked for rarely, some in between
        # keep it near.
        if self._due_us is None or self._due_us < packet.t_start_us:
            self._due_us = packet.t_start_us + self._longest_us
        while self._due_us < packet.t_end_us:
            due_us = int(self._due_us)
            before, packet = packet.split(due_us)
            self._take_in(before)
            self._locate(due_us)
        self._take_in(packet)

    def _take_in(self, packet: EventPacket) -> None:
        self._map.absorb(packet)
        self._kept.count(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        self._locate(t_us)
        detected_px, reference_px = self._given_px.copy(), self._calibration.reference_px
        # A law may have a memory: it sees those estimates alone that were asked for.
        position_px = self._law.update(detected_px, reference_px)
        return MarkerFrame(
            t_us=t_us,
            detected_px=detected_px,
            position_px=position_px,
            displacement_px=position_px - reference_px,
            coasted=self._manager.coasted | self._outside,
            confidence=self._confidence,
        )

    def _locate(self, t_us: int) -> None:
        """Find where the markers are at ``t_us``, and how well that is supported."""
        dt_s = 0.0 if self._t_us is None else (t_us - self._t_us) * 1e-6
        self._t_us = t_us
        self._due_us = t_us + self._longest_us
        predicted_px = self._filter.predict(dt_s)
        asked = self._locator.needs_expectation
        expected_px = self._manager.neighbours.expected_px(predicted_px) if asked else None
        located_px, agreement = self._locator.locate(self._map, predicted_px, expected_px, dt_s)
        self._filter.update(located_px, self._manager.coasted)
        self._maintain(t_us, located_px, agreement)
        corrected_px = self._corrected(dt_s)
        self._given_px, self._outside = self._manager.neighbours.bounded_px(
            corrected_px, corrected_px, 1.0
        )
        self._confidence = self._manager.confidence(agreement, self._outside, dt_s)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self._map.reset()
        self._law.reset()
        self._locator.reset()
        self._start()

    def begin_at(self, position_px: NDArray[np.float64]) -> None:
        """Forget everything, and begin with ``(m, 2)`` markers at rest elsewhere, px."""
        self.reset()
        self._map.repaint(painted_levels(self._calibration, self._appearance, position_px))
        self._filter = MotionFilter(position_px)
        self._backlash = self._no_backlash_yet(position_px)

    def _no_backlash_yet(self, start_px: NDArray[np.float64]) -> BacklashCompensation:
        shares = self._maintenance_config.backlash, self._maintenance_config.turn_backlash
        neighbours = self._manager.neighbours.index
        return BacklashCompensation(self._crossings_px, shares, start_px, neighbours)

    def _start(self) -> None:
        self._t_us: int | None = None
        self._due_us: float | None = None
        period_us = self._maintenance_config.period_us
        self._counting, self._listening = PeriodicTask(period_us), PeriodicTask(period_us, 1 / 4)
        self._judging = PeriodicTask(period_us, 2 / 4)
        # A turn's markers are so few that it delays no estimate; each has its turn as often.
        groups = self._maintenance_config.leak_groups
        count = len(self._calibration.reference_px)
        parts = min(max(-(-count // (groups * MOST_LEAKING)), 1), MOST_PARTS)
        self._leaking, self._groups = PeriodicTask(period_us // parts, 3 / 4), groups * parts
        self._turn = 0
        self._leak_tolerances = LeakTolerances(
            self._maintenance_config.leak_tolerance * self._mean_step,
            self._maintenance_config.lossy_leak_tolerance * self._mean_step,
            self._locator.largest_fall,
        )
        self._filter = MotionFilter(self._calibration.reference_px)
        self._manager = TrackManager(self._calibration)
        self._backlash = self._no_backlash_yet(self._calibration.reference_px)
        rests = self._calibration.reference_px, self._manager.neighbours
        self._zero = ReleasedZero(*rests) if self._calibration.recovery_s is not None else None
        self._kept = EventLoss(self._calibration)
        self._cells = self._kept.take(0.0)
        if self._maintenance_config.adapt_to_loss:
            self._map.set_events_kept(self._kept.share)

    def _maintain(
        self, t_us: int, located_px: NDArray[np.float64], agreement: NDArray[np.float64]
    ) -> None:
        """Do what is due: is the stream whole, is every marker there, what leaves the map."""
        if (since_s := self._counting.turn_s(t_us)) is not None:
            self._count_events(since_s)
        if self._listening.turn_s(t_us) is not None:
            self._manager.listen(self._filter.velocity_px_s, self._cells, self._kept.share)
        if self._judging.turn_s(t_us) is not None:
            self._manager.judge(t_us, located_px, agreement, self._map.values)
            if self._manager.placed:
                moved = self._manager.moved
                self._filter.place(moved, self._manager.position_px[moved])
        if (since_s := self._leaking.turn_s(t_us)) is not None:
            self._leak(since_s, agreement)

    def _count_events(self, dt_s: float) -> None:
        """Compare the events with those that the motion asks for."""
        self._cells = self._kept.take(dt_s)
        if self._maintenance_config.adapt_to_loss:
            position_px, velocity_px_s = self._filter.position_px, self._filter.velocity_px_s
            share = self._kept.update(position_px, velocity_px_s, self._cells)
            if share is not None:
                self._map.set_events_kept(share)

    def _leak(self, dt_s: float, agreement: NDArray[np.float64]) -> None:
        """Let the map around some markers leak towards their discs; resting discs ease theirs."""
        settings, time_s = self._maintenance_config, dt_s * self._groups
        if time_s <= 0.0 or not (settings.leak_per_s or settings.outline_return_per_s):
            return
        tolerance = self._leak_tolerances.update(agreement, dt_s, self._doubt)
        self._turn += 1
        some = slice(self._turn % self._groups, None, self._groups)
        position_px, outline_px = self._filter.position_px[some], self._locator.outline_px[some]
        tables = self._tables.of(some)
        leak_to_discs_kernel(
            self._map.padded,
            self._map.memory,
            position_px,
            outline_px,
            tables,
            settings.leak_reach_px,
            tolerance[some],
            1.0 - np.exp(-settings.leak_per_s * time_s),
        )
        ease_outlines_kernel(
            self._map.padded,
            self._map.memory,
            (position_px, self._filter.velocity_px_s[some], outline_px),
            self._calibration.radius_px[some],
            tables,
            (1.0 - np.exp(-settings.outline_return_per_s * time_s), AT_REST_PX_S),
        )
        if settings.ground_return_per_s:
            self._return_ground(dt_s * GROUND_TURNS)

    def _return_ground(self, time_s: float) -> None:
        """Let some rows of the ground, where no disc is, return to its level."""
        # A lost marker is looked for in the map: around it nothing changes.
        searched_px = min(self._manager.capture_px, float(max(self._calibration.size)))
        reach_px = self._ground_px + searched_px * self._manager.coasted
        rates_hz = self._kept.background_hz_px, self._maintenance_config.ground_return_per_s
        below, above = (1.0 - math.exp(-rate_hz * time_s) for rate_hz in rates_hz)
        return_ground_kernel(
            self._map.padded,
            self._map.memory,
            (self._turn % GROUND_TURNS, GROUND_TURNS),
            (self._filter.position_px, reach_px),
            (self._ground_step, below, above),
        )

    def _corrected(self, dt_s: float) -> NDArray[np.float64]:
        """Return the filtered places, ``(m, 2)``, px, with what they lag behind made good."""
        fit_px, velocity_px_s = self._filter.position_px, self._filter.velocity_px_s
        known = self._kept.judged or not self._maintenance_config.adapt_to_loss
        background_hz_px = self._kept.background_hz_px
        detected_px = self._backlash.update(
            fit_px, velocity_px_s, self._lag_s, known=known, background_hz_px=background_hz_px
        )
        detected_px = self._manager.neighbours.shrunk_px(detected_px, self._noise_px)
        if self._zero is not None:
            coasted = self._manager.coasted
            detected_px = self._zero.update(detected_px, velocity_px_s, coasted, dt_s)
        return detected_px
