"""The project's own tracker: presets ``default`` and ``fast``.

Events are integrated into a graded map, and discs are fitted to it with a Kalman filter for each
marker. The estimates are corrected for lag, hysteresis (backlash) and outliers among neighbours
(:mod:`spikingtac.markers.graded.corrections`). Slower tasks take turns: lost markers are predicted
from their neighbours and found again (:mod:`spikingtac.markers.graded.track_management`), a skin
whose release lost its events is put back (:mod:`spikingtac.markers.graded.misplaced_skin`), steps
grow when events are lost (:mod:`spikingtac.markers.graded.event_loss`), and the map leaks towards
the fitted discs (:mod:`spikingtac.markers.graded.map_leak`).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.appearance import needs_dead_bands
from spikingtac.markers.graded.corrections import OutputCorrections, ReleasedSkin
from spikingtac.markers.graded.disc_locator import DiscLocator
from spikingtac.markers.graded.event_loss import SILENCE_US, EventLoss
from spikingtac.markers.graded.map_leak import MapLeak
from spikingtac.markers.graded.misplaced_skin import MisplacedSkin
from spikingtac.markers.graded.motion import NEVER_US
from spikingtac.markers.graded.track_management import TrackManager
from spikingtac.markers.laws import OutputLaw
from spikingtac.schema import require_within
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

# Delay of the events where nothing was calibrated: 150 us of latency and a 2 kHz photoreceptor's
# mean time constant (the twin's preset ``typical``).
LAG_DEFAULT_US = 500.0

# Longest time between estimates, us; where fewer are requested, some are made in between. (At 2 ms
# discs are as accurate as at 1 ms; at 30 ms they lose markers.)
LONGEST_PERIOD_US = 2_000

# Least time between two leaks of the map, and between two tasks, us. (Leaks that are put off by 1
# or 2 ms at estimates with many fits cost 5 or 21 % of the mean error of ``default`` on v2e's
# recording.)
TASK_PERIOD_US = 1_000

# At a shorter period of estimates no task runs beside a leak. Both are put off by up to another
# TASK_PERIOD_US if more than this many events per marker came since the last estimate. 10,000
# estimates a second so have shorter peaks and the same errors.
SHORT_PERIOD_S, MANY_EVENTS = 0.5e-3, 8

# Round robin of the slower tasks: event loss, silent markers, lost markers, a misplaced skin.
TASK_SLOTS = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class GradedTrackerConfig:
    """Settings of the tracker; a value of 0 switches a correction off.

    Attributes:
        leak_per_s: Rate at which levels of the map relax towards the fitted discs, 1/s. It removes
            the errors that noise and lost events leave in the map.
        backlash: Share of the backlash that is compensated.
        shrink: Share of a fit's error by which residuals against the neighbours shrink.
        adapt_to_loss: Whether steps grow when fewer events arrive than the motion should cause.
        dead_bands: Whether discs are fitted to dead bands instead of levels, on sensors whose
            pixels do not recover, and whose events stand for much (a step above 0.3 of a swing) or
            whose edges are wide (above 1.2 px).
    """

    leak_per_s: float = field(default=30.0, metadata={"range": (0.0, 100.0), "unit": "1/s"})
    backlash: float = field(default=1.0, metadata={"range": (0.0, 1.0)})
    shrink: float = field(default=1.0, metadata={"range": (0.0, 2.0)})
    adapt_to_loss: bool = field(default=True, metadata={"range": (0, 1)})
    dead_bands: bool = True

    def __post_init__(self) -> None:
        not_negative = 0.0, np.inf
        require_within(self, leak_per_s=not_negative, backlash=not_negative, shrink=not_negative)


class GradedTracker:
    """Tracks markers by disc fits on a graded state map.

    Attributes:
        calibration: Of the sensor.
        lag_s: Delay of the events behind the motion, s.
        silences: How often the camera sent nothing for a while, not even noise.
    """

    def __init__(
        self,
        config: GradedTrackerConfig,
        calibration: Calibration,
        law: OutputLaw | None = None,
    ) -> None:
        """Paint the map from the calibration, so that no bootstrap slides are needed.

        Args:
            config: Settings.
            calibration: Rest positions and appearance of the markers.
            law: Output law from detected to given position; None gives the detected position.
        """
        self.calibration = calibration
        self._law = law or OutputLaw()
        # A fit to dead bands needs no leak, since it corrects levels itself, and no compensation of
        # backlash. Steps do not adapt: the loss is measured by full swings, which are rare.
        self._bands = config.dead_bands and needs_dead_bands(calibration)
        without = {"adapt_to_loss": False, "leak_per_s": 0.0, "backlash": 0.0}
        self._config = replace(config, **without) if self._bands else config
        self._locator = DiscLocator(calibration, self._bands)
        self.lag_s = 1e-6 * (LAG_DEFAULT_US if calibration.lag_us is None else calibration.lag_us)
        self._start()

    @property
    def state_map(self) -> GradedStateMap:
        """The present map; read it for a display, but do not change it."""
        return self._locator.map

    @property
    def markers(self) -> NDArray[np.void]:
        """``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`); read them only."""
        return self._locator.markers

    @property
    def hot_pixels(self) -> int:
        """Number of pixels that became hot since the start; their events are ignored."""
        return self._locator.hot.found

    def absorb(self, packet: EventPacket) -> None:
        """Process all events of the next interval of time, however long it is.

        Raises:
            ConfigError: The recording comes from a sensor of another size.
        """
        # A fit converges from nearby only: estimates in between keep the prediction near the disc.
        if self._next_estimate_us < packet.t_start_us:
            self._next_estimate_us = packet.t_start_us + LONGEST_PERIOD_US
        while self._next_estimate_us < packet.t_end_us:
            before, packet = packet.split(self._next_estimate_us)
            self._integrate(before)
            self._locate(self._next_estimate_us)
        self._integrate(packet)

    def _integrate(self, packet: EventPacket) -> None:
        if len(packet):
            self._events, self._heard_us = self._events + len(packet), int(packet.t[-1])
        self._locator.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        detected_px, coasted, confidence = self._locate(t_us)
        reference_px = self.calibration.reference_px
        # A law may have a memory: it sees only the estimates that were requested.
        position_px = self._law.update(detected_px, reference_px)
        displacement_px = position_px - reference_px
        return MarkerFrame(t_us, detected_px, position_px, displacement_px, coasted, confidence)

    def _locate(self, t_us: int) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
        """Return positions at ``t_us``, px, which markers are coasted, and their confidence."""
        locator, manager = self._locator, self._manager
        locator.locate(t_us, manager.coasted, self._event_loss.background_hz_px)
        dt_s = _seconds(locator.times_us[0], t_us)
        self._next_estimate_us = t_us + LONGEST_PERIOD_US
        silent = t_us - self._heard_us > SILENCE_US and self._note_silence(t_us)
        self._run_slower_work(t_us, dt_s)
        # Until the event loss is measured, steps are assumed larger than they are, and discs lead
        # their markers as often as they lag.
        known = self._event_loss.measured or not self._config.adapt_to_loss
        backlash = self._config.backlash if known else 0.0
        noise = self._event_loss.background_hz_px, dt_s
        given_px = self._corrections.update(t_us, locator.markers, self.lag_s, backlash, noise)
        if self._released is not None:
            given_px = self._released.update(given_px, locator.markers, manager.coasted, dt_s)
        return given_px, manager.coasted.copy(), manager.confidence(locator.markers, dt_s, silent)

    def _note_silence(self, t_us: int) -> bool:
        """Return whether the camera sends not even noise, and count such silences once each."""
        silent = self._event_loss.is_silence((t_us - self._heard_us) * 1e-6)
        if silent and self._silence_us != self._heard_us:
            self._silence_us, self.silences = self._heard_us, self.silences + 1
        return silent

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self._locator.reset()
        self._law.reset()
        self._start()

    def _start(self) -> None:
        self._counted_events = self._locator.event_count
        # The next estimate is made at this time; leak, task and count happened last at theirs.
        self._next_estimate_us = self._leak_us = self._task_us = self._count_us = NEVER_US
        self._task_count = self._events = self.silences = 0
        # The camera's last event, and the last one before a silence that was counted.
        self._heard_us = self._silence_us = NEVER_US
        self._manager = TrackManager(self.calibration)
        self._misplaced = MisplacedSkin(self.calibration)
        neighbours = self._manager.neighbours
        self._corrections = OutputCorrections(self.calibration, neighbours, self._config.shrink)
        recovers = self.calibration.recovery_s is not None
        forgets = recovers or self._bands
        self._released = ReleasedSkin(neighbours, recovers) if forgets else None
        self._event_loss = EventLoss(self.calibration, self._locator.area_px)
        leak_per_s = self._config.leak_per_s
        self._leak = MapLeak(self.calibration, leak_per_s) if leak_per_s else None
        if self._config.adapt_to_loss:
            self._locator.map.arrival_ratio = self._event_loss.arrival_ratio

    def _run_slower_work(self, t_us: int, dt_s: float) -> None:
        """Leak the map and run a task, if they are due ``dt_s`` after the last estimate."""
        short = 0.0 < dt_s < SHORT_PERIOD_S
        crowded = short and self._events > MANY_EVENTS * len(self._locator.markers)
        period_us = TASK_PERIOD_US + (TASK_PERIOD_US if crowded else 0)
        leaks = t_us >= self._leak_us + period_us
        if t_us >= self._task_us + period_us and not (leaks and short):
            self._run_task(t_us)
        if leaks:
            since_s, self._leak_us = _seconds(self._leak_us, t_us), t_us
            if self._leak is not None and since_s:
                self._leak.update(self._locator, since_s, self._event_loss.background_hz_px)
        self._events = 0

    def _run_task(self, t_us: int) -> None:
        """Run one task in turn: event loss, silent markers, lost ones, or a misplaced skin."""
        locator, manager, event_loss = self._locator, self._manager, self._event_loss
        task, self._task_count = self._task_count % TASK_SLOTS, self._task_count + 1
        self._task_us = t_us
        if task == 0:
            event_count = locator.event_count
            self._counts = event_count - self._counted_events, _seconds(self._count_us, t_us)
            self._count_us, self._counted_events = t_us, event_count
            if self._counts[1] > 0.0:
                event_loss.update(locator.markers, *self._counts)
                if self._config.adapt_to_loss:
                    locator.map.arrival_ratio = event_loss.arrival_ratio
        elif task == 1:
            manager.update_silent(locator.markers, *self._counts, event_loss)
        elif task == 2:
            relocated = manager.update(t_us, locator.markers, locator.map.values)
            if relocated.any():
                locator.place(relocated, manager.position_px)
        elif self._misplaced.update(
            locator.markers, locator.map, *self._counts, event_loss.noise_per_s
        ):
            locator.map.reset()
            locator.place(np.ones_like(manager.coasted), self.calibration.reference_px)
            manager.doubt = None


def _seconds(before_us: int, t_us: int) -> float:
    """Return the time between two, s; 0 where the first one never was."""
    return 0.0 if before_us == NEVER_US else (t_us - before_us) * 1e-6
