"""Windows of events, their counts without contact, and the protocol of a contact detector."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.types import Contact, EventPacket

SECONDS_PER_HOUR = 3600.0
BLOCK_WINDOWS = 30  # Windows of a block: half a period of the arm's vibration, 15 Hz.
CLEAR_SIGMA = 5.0  # A block this many standard deviations above others holds more than noise.

# Fewest events of a block of an even stream, and largest share by which its blocks differ.
LEAST_EVEN, EVEN_SHARE = 20, 0.5
LEAST_WINDOWS = 100  # Fewer windows determine a variance to no better than 15 %.
WINDOW_US = 1_000  # Raw events are counted in windows of 1 ms (paper section V-B).

# The events of one period: of one sensor, or one packet per sensor, in the sensors' order.
Window: TypeAlias = EventPacket | tuple[EventPacket, ...]


def packets_of(window: Window) -> tuple[EventPacket, ...]:
    """Return the packets of a window, one per sensor."""
    return window if isinstance(window, tuple) else (window,)


def count_of(window: Window) -> int:
    """Return how many events a window holds, over all sensors."""
    if isinstance(window, tuple):
        return sum(len(packet) for packet in window)
    return len(window)


@dataclass(frozen=True, kw_only=True)
class QuietStatistics:
    """Counts of windows without contact.

    Attributes:
        mean: Events per window.
        variance: Of the same; above the mean where events come in bursts (an arm that shakes).
        highest: The highest count.
        windows: Number of windows.
        period_s: Length of a window, s.
    """

    mean: float
    variance: float
    highest: int
    windows: int
    period_s: float

    @classmethod
    def of(cls, windows: Iterable[Window]) -> QuietStatistics:
        """Count regular windows; record them while the arm moves, not while it rests.

        Raises:
            CalibrationError: There are fewer than 100 windows.
        """
        counter = WindowCounter()
        deque(counter.counted(windows), maxlen=0)
        return counter.statistics()

    def threshold(self, false_alarms_per_hour: float) -> int:
        """Return the least count that is exceeded less often than the budget.

        A negative binomial distribution with this mean and variance models the counts: it is
        Poisson where the variance equals the mean, and has a longer tail where events come in
        bursts. Its tail beyond the recorded time is an extrapolation: check it on other data.

        Args:
            false_alarms_per_hour: The budget.

        Raises:
            ConfigError: The budget is not a positive number.
        """
        from scipy.special import betainc, pdtrc  # scipy.stats would take 0.6 s to import

        check_budget(false_alarms_per_hour)
        chance = false_alarms_per_hour * self.period_s / SECONDS_PER_HOUR
        mean = max(self.mean, 1.0 / self.windows)
        excess = self.variance - mean
        if excess <= mean * math.sqrt(2.0 / self.windows):
            return _least_count(lambda count: pdtrc(count, mean), chance)
        size = mean**2 / excess
        return _least_count(lambda count: betainc(count + 1, size, mean / (size + mean)), chance)


def _least_count(survival: Callable[[int], float], chance: float) -> int:
    """Return the least count that is exceeded with at most this chance.

    Args:
        survival: The chance that a count is exceeded; it falls with the count.
        chance: The largest chance allowed, above 0.
    """
    if chance >= 1.0:  # every window may exceed it
        return -1
    above = 1
    while survival(above - 1) > chance:
        above *= 2
    below = above // 2 - 1
    above -= 1
    while above - below > 1:
        middle = (above + below) // 2
        below, above = (middle, above) if survival(middle) > chance else (below, middle)
    return above


class WindowCounter:
    """Counts the events of the windows that pass through it."""

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._period_us = 0

    def counted(self, windows: Iterable[Window]) -> Iterator[Window]:
        """Yield the windows unchanged, and count each."""
        for window in windows:
            first = packets_of(window)[0]
            # The last window of a stream may be shorter than the others.
            self._period_us = self._period_us or first.t_end_us - first.t_start_us
            self._counts.append(count_of(window))
            yield window

    def statistics(self) -> QuietStatistics:
        """Return the statistics of all windows so far.

        Raises:
            CalibrationError: There are fewer than 100 windows.
        """
        if len(self._counts) < LEAST_WINDOWS:
            raise CalibrationError(
                f"{len(self._counts)} quiet windows are too few, at least {LEAST_WINDOWS} are "
                "needed; record the moving arm for longer"
            )
        values = np.array(self._counts)
        return QuietStatistics(
            mean=float(values.mean()),
            variance=float(values.var(ddof=1)),
            highest=int(values.max()),
            windows=len(values),
            period_s=self._period_us * 1e-6,
        )


def check_budget(false_alarms_per_hour: float) -> None:
    """Refuse a budget of false alarms that is not a positive number.

    Raises:
        ConfigError: It is zero, negative, infinite or not a number.
    """
    if not 0.0 < false_alarms_per_hour < math.inf:
        raise ConfigError(
            f"the budget is {false_alarms_per_hour} false contacts per hour, it must be positive"
        )


def unsettled(count: NDArray[np.int64]) -> int:
    """Return how many of the first windows of a recording tell nothing of what follows.

    A camera may begin with a burst (its pixels settle after the start), or deliver nothing for a
    while. Blocks of a burst stand out from the later half of the blocks; a silent beginning counts
    as such where an even stream follows it, since a sensor without noise is silent too.

    Args:
        count: ``(n,)`` events of the first windows, n at least ten times :data:`BLOCK_WINDOWS`.
    """
    blocks = count[: len(count) // BLOCK_WINDOWS * BLOCK_WINDOWS].reshape(-1, BLOCK_WINDOWS)
    sums = blocks.sum(axis=1)
    later = sums[len(sums) // 2 :]
    middle = float(np.median(later))
    limit = middle + CLEAR_SIGMA * max(float(later.std()), math.sqrt(middle), 1.0)
    calm = int((sums <= limit).argmax())
    even = middle >= LEAST_EVEN and np.abs(later / max(middle, 1.0) - 1.0).max() <= EVEN_SHARE
    silent = int((count > 0).argmax()) if even else 0
    return max(calm * BLOCK_WINDOWS, silent if silent >= BLOCK_WINDOWS else 0)


@dataclass(frozen=True, slots=True)
class GelTouch:
    """A contact as one sensor saw it.

    Attributes:
        place_px: ``(x, y)`` centroid of the displaced markers, weighted by their evidence, px.
        push: ``(x, y)`` mean direction of their motion, in image axes. Its length is 1 where all
            markers moved alike, and near 0 where they turned about their centroid.
        turn: -1 to 1: how far the motion is a rotation about the centroid, positive from x to y
            (clockwise as displayed).
        markers: How many markers moved.
    """

    place_px: tuple[float, float]
    push: tuple[float, float]
    turn: float
    markers: int

    def as_mapping(self) -> dict[str, Any]:
        """Return the fields, rounded to 0.1 px and 0.001, as JSON can hold them."""
        return {
            "place_px": [round(value, 1) for value in self.place_px],
            "push": [round(value, 3) for value in self.push],
            "turn": round(self.turn, 3),
            "markers": self.markers,
        }


@dataclass(frozen=True, slots=True)
class ContactDetails:
    """What is known about a contact beyond the decision.

    Attributes:
        onset_us: The most likely time at which the motion began, us.
        touches: One entry per sensor; None for a sensor whose markers did not move.
    """

    onset_us: int
    touches: tuple[GelTouch | None, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Return ``onset_us`` and ``sensors``, as JSON can hold them."""
        return {
            "onset_us": self.onset_us,
            "sensors": [touch.as_mapping() if touch else None for touch in self.touches],
        }


@dataclass(frozen=True, kw_only=True)
class DetectorSummary:
    """What a detector was built from, and when it reports a contact.

    Attributes:
        rule: The decision rule with its threshold, one sentence for people.
        quiet: Event counts of the quiet windows that the detector learned from; None where it was
            given its threshold or has not learned yet.
        figures: The detector's own figures by name, as JSON can hold them.
    """

    rule: str
    quiet: QuietStatistics | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class ContactDetector(Protocol):
    """Decides on contact from regular windows; it never waits for an image or a network.

    Attributes:
        in_contact: True from a contact until its end.
    """

    in_contact: bool

    def update(self, window: Window) -> Contact | None:
        """Take the next window and return a contact where one begins.

        Args:
            window: The events of one period. Empty windows are given too: silence is data.
        """
        ...

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        ...

    def details(self) -> ContactDetails | None:
        """Return onset and place of the present contact.

        Returns:
            None where there is no contact, or where the detector does not know more about it.
        """
        ...

    def summary(self) -> DetectorSummary:
        """Return what the detector was built from, and its decision rule."""
        ...
