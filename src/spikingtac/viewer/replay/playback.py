"""A recording or a running source, tracked forwards and revisited at any time.

The tracker's state at a time depends on everything before it. To go back, playback takes the last
copy that was kept before that time and tracks again from there. The result is exact, because any
cutting of the stream gives the same result.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.window import WINDOW_US
from spikingtac.events.source_health import SLOT_US, slot_rate_ev_s, source_health
from spikingtac.events.windows import SILENCE_LIMIT_US
from spikingtac.markers.tracker import MarkerTracker
from spikingtac.pipeline.follow import EstimateTimes, check_rate
from spikingtac.types import Contact, MarkerFrame, SourceHealth
from spikingtac.viewer.replay.event_store import EventStore
from spikingtac.viewer.replay.tracker_history import TrackerHistory

RECENT_STEPS = 2_000  # Step times kept for the percentiles, 2 s at 1 kHz.


@dataclass(frozen=True, slots=True)
class _State:
    tracker: MarkerTracker
    detector: ContactDetector | None
    step: int
    frame: MarkerFrame | None


class Playback:
    """Tracks a stream up to an aim, a slice of work at a time, so that its caller stays responsive.

    Estimates are made at the same times as by :func:`~spikingtac.pipeline.follow.follow`.

    Attributes:
        store: The events.
        position_us: Everything before this time was tracked.
        aim_us: Where :meth:`work` leads to.
        frame: The estimate at the last estimate time, or None before the first.
        contacts: The contacts found so far, by time.
        steps: Estimates made so far, those of repeated stretches included.
    """

    def __init__(
        self,
        store: EventStore,
        make_tracker: Callable[[], MarkerTracker],
        make_detector: Callable[[], ContactDetector | None] = lambda: None,
        *,
        rate_hz: float,
        on_frame: Callable[[MarkerFrame], None] = lambda _: None,
    ) -> None:
        """Prepare to track; nothing is computed yet.

        Args:
            store: The events.
            make_tracker: Builds the tracker, anew at each :meth:`retune`.
            make_detector: Builds the contact detector, or returns None.
            rate_hz: Estimates per second of data time.
            on_frame: Is given every estimate; those of repeated stretches again.

        Raises:
            ConfigError: The rate is not between 0 and 1 MHz.
        """
        check_rate(rate_hz)
        self.store = store
        self.contacts: dict[int, Contact] = {}
        self.steps = 0
        self._rate_hz, self._on_frame = rate_hz, on_frame
        self._make_tracker, self._make_detector = make_tracker, make_detector
        self._step_s: deque[float] = deque(maxlen=RECENT_STEPS)
        self._spent_s = 0.0
        self._rated_us, self._rate_ev_s = -1, 0.0
        self.aim_us = store.t_start_us
        self._restart()

    @property
    def tracker(self) -> MarkerTracker:
        """The tracker, as it stands at the position."""
        return self._tracker

    @property
    def in_contact(self) -> bool:
        """Whether the contact detector reports a contact at the position."""
        return self._detector is not None and self._detector.in_contact

    def aim(self, t_us: int) -> None:
        """Set where to go, before or after the position."""
        self.aim_us = max(t_us, self.store.t_start_us)
        if self.aim_us >= self.position_us:
            return
        found = self._history.before(self.aim_us)
        if found is None:
            self._rewind()  # the later copies stay valid: the same events give the same states
            return
        self.position_us, state = found
        self._tracker, self._detector = state.tracker, state.detector
        self._step, self.frame = state.step, state.frame

    def retune(self, make_tracker: Callable[[], MarkerTracker]) -> None:
        """Track again from the beginning with another tracker, up to the present aim."""
        self._make_tracker = make_tracker
        self._restart()

    def work(self, budget_s: float) -> bool:
        """Track towards the aim for about ``budget_s``; True once it is reached."""
        until_s = time.perf_counter() + budget_s
        while self.position_us < self.aim_us:
            if not self._advance():
                self.aim_us = self.position_us
                return True
            if time.perf_counter() > until_s:
                return self.position_us >= self.aim_us
        return True

    def step_percentiles_us(self) -> tuple[float, float]:
        """Return p50 and p99 of the time that a step (absorb and estimate) takes, us."""
        if not self._step_s:
            return 0.0, 0.0
        p50_s, p99_s = np.percentile(np.array(self._step_s), (50, 99))
        return float(p50_s) * 1e6, float(p99_s) * 1e6

    def _advance(self) -> bool:
        """Go on to the next estimate time or window's end; False where the source has ended."""
        store = self.store
        since_us = self.position_us - store.t_start_us
        window_us = store.t_start_us + (since_us // WINDOW_US + 1) * WINDOW_US
        estimate_us = self._next_estimate_us(window_us)
        edge_us = window_us if estimate_us is None else min(estimate_us, window_us)
        if not store.extend_to(edge_us):
            return False
        resumes_us = self.resumes_us(edge_us)
        if resumes_us is not None:
            self._pass_silence(resumes_us)
            return True
        if edge_us == window_us:
            self._detect(window_us)
        self._track(edge_us, estimate=edge_us == estimate_us)
        self.position_us = edge_us
        if edge_us == estimate_us:
            self._step += 1
            self.steps += 1
            if self.frame is not None:
                self._on_frame(self.frame)
        state = _State(self._tracker, self._detector, self._step, self.frame)
        self._history.offer(edge_us, store.t_start_us, state)
        return True

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

    def _pass_silence(self, resumes_us: int) -> None:
        """Go on towards the next event without estimates, as `follow` does."""
        self.position_us = min(self.aim_us, resumes_us)
        first_us = self.store.first_event_us
        if first_us is not None and self.position_us == resumes_us:
            self._step = EstimateTimes(first_us, self._rate_hz).index(resumes_us) + 1

    def _next_estimate_us(self, needed_until_us: int) -> int | None:
        """Return the next estimate time, or None if there is no event before the given time."""
        if self.store.first_event_us is None:
            self.store.extend_to(needed_until_us)
        first_us = self.store.first_event_us
        if first_us is None:
            return None
        return EstimateTimes(first_us, self._rate_hz).at(self._step)

    def _detect(self, end_us: int) -> None:
        if self._detector is None:
            return
        contact = self._detector.update(self.store.between(end_us - WINDOW_US, end_us))
        if contact is not None:
            self.contacts[contact.t_us] = contact

    def _track(self, edge_us: int, *, estimate: bool) -> None:
        first_us = self.store.first_event_us
        if first_us is None or edge_us < first_us:
            return  # tracking begins at the first event, as in `follow`
        start_us = max(self.position_us, first_us)
        packet = self.store.between(start_us, edge_us)
        begun_s = time.perf_counter()
        if start_us < edge_us:
            self._tracker.absorb(packet)
        if estimate:
            self.frame = self._tracker.estimate(edge_us).with_health(self._health(edge_us))
        self._spent_s += time.perf_counter() - begun_s
        if estimate:
            self._step_s.append(self._spent_s)
            self._spent_s = 0.0

    def _health(self, t_us: int) -> SourceHealth:
        """Return the stream's health at a time, as `follow` gives it."""
        first_us = self.store.first_event_us
        until_us = t_us // SLOT_US * SLOT_US
        if first_us is not None and until_us != self._rated_us:
            rate_ev_s = slot_rate_ev_s(t_us, first_us, lambda *span: len(self.store.between(*span)))
            self._rated_us, self._rate_ev_s = until_us, rate_ev_s
        return source_health(self.store.losses, self._rate_ev_s)

    def _restart(self) -> None:
        self._history: TrackerHistory[_State] = TrackerHistory()
        self._rewind()

    def _rewind(self) -> None:
        self._tracker, self._detector = self._make_tracker(), self._make_detector()
        self.position_us, self._step = self.store.t_start_us, 0
        self.frame: MarkerFrame | None = None
