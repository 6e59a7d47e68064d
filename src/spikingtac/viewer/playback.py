"""A recording or a running source, tracked forwards and revisited at any time.

The tracker's state at a time depends on everything before it. To go back, playback takes the last
copy that was kept before that time and tracks again from there. The result is exact, because any
cutting of the stream gives the same result.
"""

import copy
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac.contact.detector import WINDOW_US, ContactDetector
from spikingtac.events.source import SLOT_US, slot_rate_ev_s, source_health
from spikingtac.events.windows import SILENCE_LIMIT_US
from spikingtac.markers.registry import MarkerTracker
from spikingtac.pipeline.follow import EstimateTimes, check_rate
from spikingtac.types import Contact, MarkerFrame
from spikingtac.viewer.source import EventStore, ViewSource

RECENT_STEPS = 2_000  # Step times kept for the percentiles, 2 s at 1 kHz.

# First distance between kept copies, us; tracking it again takes a fraction of it.
FIRST_DISTANCE_US = 250_000

# Most pixels in all copies of the state: 20 copies of 320x320, of which one of `default` holds
# 6 MB. Beyond them every other copy goes, and the distance doubles.
MOST_PIXELS = 2_048_000


@dataclass(slots=True)
class State:
    """What depends on everything before the position."""

    tracker: MarkerTracker
    detector: ContactDetector
    step: int = 0
    frame: MarkerFrame | None = None


class Playback:
    """Tracks a stream up to an aim, a slice of work at a time, so that its caller stays responsive.

    Estimates are made at the same times as by :func:`~spikingtac.pipeline.follow.follow`.

    Attributes:
        store: The events.
        view: How they are tracked.
        position_us: Everything before this time was tracked.
        aim_us: Where :meth:`work` leads to.
        config: Settings of the tracker.
        contacts: The contacts found so far, by time.
        steps: Estimates made so far, those of repeated stretches included.
        state: Tracker and contact detector, as they stand at the position.
    """

    def __init__(
        self,
        store: EventStore,
        view: ViewSource,
        on_frame: Callable[[MarkerFrame], object] = lambda _: None,
    ) -> None:
        """Prepare to track; nothing is computed yet.

        Args:
            store: The events.
            view: How they are tracked: tracker, contact detector, rate.
            on_frame: Is given every estimate; those of repeated stretches again.

        Raises:
            ConfigError: The rate is not between 0 and 1 MHz.
        """
        check_rate(view.rate_hz)
        self.store, self.steps = store, 0
        self.contacts: dict[int, Contact] = {}
        self.view, self._on_frame = view, on_frame
        self._step_s: deque[float] = deque(maxlen=RECENT_STEPS)
        self._spent_s = 0.0
        self._rated_slot, self._rate_ev_s = -1, 0.0
        self.aim_us = store.t_start_us
        self.retune(view.config)

    def aim(self, t_us: int) -> None:
        """Set where to go, before or after the position."""
        first_us = self.store.kept_from_us
        self.aim_us = max(t_us, first_us)
        if self.aim_us >= self.position_us:
            return
        before = [kept for kept in self._copies if first_us <= kept[0] <= self.aim_us]
        if before:
            self.position_us, self.state = copy.deepcopy(before[-1])
        else:  # the later copies stay valid: the same events give the same states
            self._rewind()

    def retune(self, config: Any) -> None:
        """Track again from the beginning with other settings, up to the present aim."""
        self.config = config
        self._copies: list[tuple[int, State]] = []
        self._distance_us: float = FIRST_DISTANCE_US
        self._rewind()

    def work(self, budget_s: float) -> bool:
        """Track towards the aim for about ``budget_s``; True once it is reached."""
        until_s = time.perf_counter() + budget_s
        while self.position_us < self.aim_us and time.perf_counter() < until_s:
            if not self._advance():
                self.aim_us = self.position_us
        return self.position_us >= self.aim_us

    def step_percentiles_us(self) -> tuple[float, float]:
        """Return p50 and p99 of the time that a step (absorb and estimate) takes, us."""
        p50_s, p99_s = np.percentile(np.array(self._step_s or [0.0]), (50, 99))
        return float(p50_s) * 1e6, float(p99_s) * 1e6

    def resumes_us(self, t_us: int) -> int | None:
        """Return when the events go on after a silence that is too long to be filled.

        Args:
            t_us: Somewhere after the position, us.

        Returns:
            The time of the next event, us; None where ``t_us`` lies in no such silence.
        """
        last_us, next_us = self.store.around(self.position_us)
        if last_us is None or next_us is None or next_us == self.position_us:
            return None
        too_long = next_us - last_us > SILENCE_LIMIT_US
        return next_us if too_long and t_us > last_us + SILENCE_LIMIT_US else None

    def _rewind(self) -> None:
        self.position_us = self.store.kept_from_us
        self.state = State(self.view.make_tracker(self.config), self.view.make_detector())
        first_us = self.store.first_event_us
        if first_us is not None and self.position_us > first_us:  # what came before is forgotten
            times = EstimateTimes(first_us, self.view.rate_hz)
            self.state.step = times.index(self.position_us) + 1

    def _advance(self) -> bool:
        """Go on to the next estimate time or window's end; False where the source has ended."""
        store, state = self.store, self.state
        windows = (self.position_us - store.t_start_us) // WINDOW_US + 1
        window_us = store.t_start_us + windows * WINDOW_US
        if store.first_event_us is None:
            store.extend_to(window_us)
        first_us = store.first_event_us
        times = None if first_us is None else EstimateTimes(first_us, self.view.rate_hz)
        estimate_us = window_us + 1 if times is None else times.at(state.step)
        edge_us = min(estimate_us, window_us)
        if not store.extend_to(edge_us):
            return False
        resumes_us = self.resumes_us(edge_us)
        if times is not None and resumes_us is not None:  # no estimates meanwhile, as in `follow`
            self.position_us = min(self.aim_us, resumes_us)
            if self.position_us == resumes_us:
                state.step = times.index(resumes_us) + 1
            return True
        if edge_us == window_us:
            contact = state.detector.update(store.between(window_us - WINDOW_US, window_us))
            if contact is not None:
                self.contacts[contact.t_us] = contact
        if times is not None and edge_us >= times.first_us:  # tracking begins at the first event
            self._track(times.first_us, edge_us, edge_us == estimate_us)
        self.position_us = edge_us
        if edge_us == estimate_us:
            state.step += 1
            self.steps += 1
            if state.frame is not None:
                self._on_frame(state.frame)
        self._keep()
        return True

    def _track(self, first_us: int, edge_us: int, estimate: bool) -> None:
        """Track up to an edge, and estimate there, with the stream's health as `follow` gives it.

        Args:
            first_us: Time of the stream's first event, us.
            edge_us: An estimate time or a window's end, us.
            estimate: Whether it is an estimate time.
        """
        tracker, start_us = self.state.tracker, max(self.position_us, first_us)
        packet = self.store.between(start_us, edge_us)
        begun_s = time.perf_counter()
        if start_us < edge_us:
            tracker.absorb(packet)
        frame = tracker.estimate(edge_us) if estimate else None
        self._spent_s += time.perf_counter() - begun_s
        if frame is None:
            return
        self._step_s.append(self._spent_s)
        self._spent_s = 0.0
        if (slot := edge_us // SLOT_US) != self._rated_slot:
            counted = slot_rate_ev_s(edge_us, first_us, lambda *at: len(self.store.between(*at)))
            self._rated_slot, self._rate_ev_s = slot, counted
        self.state.frame = frame.with_health(source_health(self.store.losses, self._rate_ev_s))

    def _keep(self) -> None:
        """Keep a copy of the state where the last one is far enough back."""
        last_us = self._copies[-1][0] if self._copies else self.store.t_start_us
        if self.position_us < last_us + self._distance_us:
            return
        try:
            self._copies.append((self.position_us, copy.deepcopy(self.state)))
        except TypeError:  # what cannot be copied (a network's session) is never kept
            self._distance_us = float("inf")
        width, height = self.store.size
        if len(self._copies) > max(MOST_PIXELS // (width * height), 2):
            self._copies = self._copies[1::2]
            self._distance_us *= 2
