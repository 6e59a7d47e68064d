"""The project's own tracker, one screen: presets ``default`` and ``fast``.

Map of levels -> disc fits with a Kalman filter for each marker -> lag, backlash, and what the
neighbours say (:mod:`spikingtac.markers.graded.corrections`). In its own time it does the rest:
lost markers are predicted from their neighbours and found again
(:mod:`spikingtac.markers.graded.track_management`), steps grow when events are lost
(:mod:`spikingtac.markers.graded.event_loss`), and the map leaks towards the fitted discs
(:mod:`spikingtac.markers.graded.map_leak`).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.hot_pixels import HotPixelWatch
from spikingtac.markers.graded.appearance import has_large_steps
from spikingtac.markers.graded.corrections import OutputCorrections, ReleasedZero
from spikingtac.markers.graded.disc_locator import DiscLocator
from spikingtac.markers.graded.event_loss import EventLoss
from spikingtac.markers.graded.map_leak import MapLeak
from spikingtac.markers.graded.motion import AGREEMENT, NEVER_US, VX, VY
from spikingtac.markers.graded.track_management import TrackManager
from spikingtac.markers.laws import OutputLaw
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket, MarkerFrame

# Delay of the events where nothing was calibrated: 150 us of latency and a 2 kHz photoreceptor's
# mean time constant (the twin's preset ``typical``).
LAG_DEFAULT_US = 500.0

# Longest time between estimates, us; where they are asked for more rarely, some are made in
# between. (At 2 ms discs are as accurate as at 1 ms; at 30 ms they lose markers.)
LONGEST_PERIOD_US = 2_000

# Least time between two leaks of the map, and between two tasks of :data:`TASKS`, us. Putting leaks
# off by 1 or 2 ms in steps with many fits costs 5 or 21 % of the mean error of ``default`` on v2e's
# recording.
TURN_US = 1_000

# Time between estimates below which a leak waits, up to another TURN_US, while more than so many
# events came for each marker, and a task for an estimate without a leak: 10,000 estimates a second
# so have shorter peaks and the same errors.
SHORT_S, MANY_EVENTS = 0.5e-3, 8

# Turns in which each task has one: the loss of events, silent markers, lost markers, and none.
TASKS = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class GradedTrackerConfig:
    """How the tracker follows discs; shares of 0 switch a correction off.

    Attributes:
        leak_per_s: Rate at which map pixels give up their disagreement with the disc, 1/s. It cures
            what noise and lost events leave in the map.
        backlash: Share of the backlash that is made good.
        shrink: Share of a fit's error by which differences from the neighbours shrink.
        adapt_to_loss: Whether steps grow when fewer events arrive than the motion asks for.
        dead_bands: Whether levels count as known within their dead bands only, where an event
            stands for much (a step above 0.3 of a swing, and pixels that do not recover).
    """

    leak_per_s: float = field(default=30.0, metadata={"range": (0.0, 100.0), "unit": "1/s"})
    backlash: float = field(default=1.0, metadata={"range": (0.0, 1.0)})
    shrink: float = field(default=1.0, metadata={"range": (0.0, 2.0)})
    adapt_to_loss: bool = field(default=True, metadata={"range": (0, 1)})
    dead_bands: bool = True

    def __post_init__(self) -> None:
        for name in ("leak_per_s", "backlash", "shrink"):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(f"{name} is {getattr(self, name)}, it must not be negative")


class GradedTracker:
    """Follows markers on a map of levels.

    Attributes:
        calibration: Of the sensor.
        lag_s: Delay of the events behind the motion, s.
    """

    def __init__(
        self,
        config: GradedTrackerConfig,
        calibration: Calibration,
        law: OutputLaw | None = None,
    ) -> None:
        """Paint the map from the calibration, so that no bootstrap slides are needed.

        Args:
            config: How it follows discs.
            calibration: Where the markers rest and how they look.
            law: From detected to given position; None gives out what was detected.
        """
        self.calibration = calibration
        self._law = law or OutputLaw()
        # A fit to dead bands corrects levels itself, steps do not grow (motion is counted in full
        # swings, which large steps do not show), and nothing silent holds it back.
        bands = config.dead_bands and has_large_steps(calibration)
        self._adapts = config.adapt_to_loss and not bands
        self._leak_per_s = 0.0 if bands else config.leak_per_s
        self._backlash = 0.0 if bands else config.backlash
        self._shrink = config.shrink
        self._locator = DiscLocator(calibration, bands)
        lag_us = LAG_DEFAULT_US if calibration.lag_us is None else calibration.lag_us
        self.lag_s = lag_us * 1e-6
        self._start()

    @property
    def state_map(self) -> GradedStateMap:
        """The map as it stands; to be read, for a display or a picture, and not changed."""
        return self._locator.map

    @property
    def motion(self) -> NDArray[np.float64]:
        """``(m, 8)`` states of the filters (:mod:`spikingtac.markers.graded.motion`); a view."""
        return self._locator.motion

    @property
    def hot_pixels(self) -> int:
        """How many pixels became hot meanwhile; their events are ignored."""
        return self._hot.found

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time, however long it is.

        Raises:
            ConfigError: The recording comes from a sensor of another size.
        """
        # A fit looks for its disc nearby: where estimates are asked for rarely, some in between
        # keep it near.
        if self._due_us < packet.t_start_us:
            self._due_us = packet.t_start_us + LONGEST_PERIOD_US
        while self._due_us < packet.t_end_us:
            before, packet = packet.split(self._due_us)
            self._take_in(before)
            self._locate(self._due_us)
        self._take_in(packet)

    def _take_in(self, packet: EventPacket) -> None:
        known = self._hot.found
        self._events += len(packet)
        self._locator.absorb(packet, self._hot)
        if self._hot.found > known:  # after the packet: no event of theirs follows
            self._locator.map.restore(self._hot.hot)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed."""
        detected_px, coasted, confidence = self._locate(t_us)
        reference_px = self.calibration.reference_px
        # A law may have a memory: it sees those estimates alone that were asked for.
        position_px = self._law.update(detected_px, reference_px)
        displacement_px = position_px - reference_px
        return MarkerFrame(t_us, detected_px, position_px, displacement_px, coasted, confidence)

    def _locate(
        self, t_us: int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
        """Return where the markers are at ``t_us``, px, who is predicted, and how sure each is."""
        locator, manager = self._locator, self._manager
        locator.locate(t_us, manager.coasted)
        self._due_us, before_us = t_us + LONGEST_PERIOD_US, locator.times_us[0]
        dt_s = 0.0 if before_us == NEVER_US else (t_us - before_us) * 1e-6
        short = 0.0 < dt_s < SHORT_S
        wait_us = TURN_US if short and self._events > MANY_EVENTS * len(locator.fits) else 0
        leaks = t_us >= self._leak_us + wait_us
        if t_us >= self._task_us + wait_us and not (leaks and short):
            self._do_task(t_us)
        # Until the stream's loss was judged steps are taken for larger than they are, and discs are
        # ahead as often as behind.
        judged = self._kept.judged or not self._adapts
        backlash = self._backlash if judged else 0.0
        if leaks:
            self._let_leak(t_us, judged)
        noise = self._kept.background_hz_px, dt_s
        given_px = self._corrections.update(t_us, locator.motion, self.lag_s, backlash, noise)
        if self._zero is not None:
            velocity_px_s = locator.motion[:, VX : VY + 1]
            given_px = self._zero.update(given_px, velocity_px_s, manager.coasted, dt_s)
        self._events = 0
        confidence = manager.confidence(locator.fits[:, AGREEMENT], dt_s)
        return given_px, manager.coasted.copy(), confidence

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self._locator.reset()
        self._law.reset()
        self._start()

    def _start(self) -> None:
        hot_px, size = self.calibration.hot_px, self.calibration.size
        self._hot = HotPixelWatch(hot_px, size, self._locator.map.pixels)
        self._leaked_us: int | None = None
        self._counted_us: int | None = None
        self._heard = self._locator.heard
        self._due_us = self._leak_us = self._task_us = NEVER_US
        self._turn = self._events = 0
        self._manager = TrackManager(self.calibration)
        neighbours = self._manager.neighbours
        self._corrections = OutputCorrections(self.calibration, neighbours, self._shrink)
        recovers = self.calibration.recovery_s is not None
        self._zero = ReleasedZero(neighbours) if recovers else None
        self._kept = EventLoss(self.calibration, self._locator.area_px)
        self._leak = MapLeak(self.calibration, self._leak_per_s) if self._leak_per_s else None
        if self._adapts:
            self._locator.map.events_kept = self._kept.share

    def _let_leak(self, t_us: int, judged: bool) -> None:
        since_s = 0.0 if self._leaked_us is None else (t_us - self._leaked_us) * 1e-6
        self._leaked_us, self._leak_us = t_us, t_us + TURN_US
        if self._leak is not None and since_s:
            self._leak.update(self._locator, since_s, judged)

    def _do_task(self, t_us: int) -> None:
        """Look after one thing: is the stream whole, does every marker send, is each there."""
        locator, manager, kept, task = self._locator, self._manager, self._kept, self._turn % TASKS
        self._task_us, self._turn = t_us + TURN_US, self._turn + 1
        if task == 0:
            counted_s = 0.0 if self._counted_us is None else (t_us - self._counted_us) * 1e-6
            heard = locator.heard
            self._counted = heard - self._heard, counted_s
            self._counted_us, self._heard = t_us, heard
            if self._adapts and counted_s > 0.0:
                kept.update(locator.motion, *self._counted)
                locator.map.events_kept = kept.share
        elif task == 1:
            manager.listen(locator.motion, *self._counted, kept)
        elif task == 2:
            manager.judge(t_us, locator.fits, locator.map.values)
            if manager.placed:
                locator.place(manager.moved, manager.position_px)
