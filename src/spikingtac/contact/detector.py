"""Windows of events, their counts without contact, and the protocol of a contact detector."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError, ConfigError
from spikingtac.types import Contact, EventPacket

SECONDS_PER_HOUR = 3600.0
# Least and largest budget of false contacts: one in a hundred years, and a tenth of all windows of
# 1 ms.
LEAST_PER_HOUR, MOST_PER_HOUR = 1e-6, 360_000.0
BLOCK_WINDOWS = 30  # Windows of a block: half a period of the arm's vibration, 15 Hz.
CLEAR_SIGMA = 5.0  # Standard deviations by which a block with motion exceeds blocks of noise.

# Fewest events of a block of an even stream, and largest share by which its blocks differ.
LEAST_EVEN, EVEN_SHARE = 20, 0.5
LEAST_WINDOWS = 100  # Fewer windows determine a variance to no better than 15 %.
MOST_EVENTS = 1 << 32  # Above any count of a window.
WINDOW_US = 1_000  # Raw events are counted in windows of 1 ms (paper section V-B).

# The events of one period: of one sensor, or one packet per sensor, in the sensors' order.
Window: TypeAlias = EventPacket | tuple[EventPacket, ...]


def packets_of(window: Window) -> tuple[EventPacket, ...]:
    """Return the packets of a window, one per sensor."""
    return window if isinstance(window, tuple) else (window,)


def count_of(window: Window) -> int:
    """Return how many events a window holds, over all sensors."""
    return sum(map(len, packets_of(window)))


class Period:
    """The length of a detector's windows; only the last one of a stream may be shorter.

    Args:
        us: The length, us; that of the first window unless given.
    """

    def __init__(self, us: int = 0) -> None:
        self.us, self._cut = us, False

    def count(self, window: Window) -> int:
        """Return how many events a window holds, unless it has another length.

        Raises:
            ConfigError: It is longer, or shorter and not the last one.
        """
        first = packets_of(window)[0]
        length_us = first.t_end_us - first.t_start_us
        self.us = self.us or length_us
        if length_us != self.us and (self._cut or length_us > self.us):
            raise ConfigError(
                f"a window lasts {length_us} us, the detector learned from windows of {self.us} us;"
                f" give such windows: spikingtac.windows(source, {self.us})"
            )
        self._cut = length_us != self.us
        return count_of(window)


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
            ConfigError: They differ in length.
        """
        period = Period()
        return cls.of_counts([period.count(window) for window in windows], period.us * 1e-6)

    @classmethod
    def of_counts(cls, counts: Sequence[int], period_s: float) -> QuietStatistics:
        """Return the statistics of windows whose events were counted.

        Raises:
            CalibrationError: There are fewer than 100 windows.
        """
        if len(counts) < LEAST_WINDOWS:
            raise CalibrationError(
                f"{len(counts)} quiet windows are too few, at least {LEAST_WINDOWS} are "
                "needed; record the moving arm for longer"
            )
        values = np.array(counts)
        return cls(
            mean=float(values.mean()),
            variance=float(values.var(ddof=1)),
            highest=int(values.max()),
            windows=len(values),
            period_s=period_s,
        )

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

        def is_rare(count: int) -> bool:
            if excess <= mean * math.sqrt(2.0 / self.windows):
                return pdtrc(count, mean) <= chance
            size = mean**2 / excess
            return betainc(count + 1, size, mean / (size + mean)) <= chance

        return bisect_left(range(MOST_EVENTS), True, key=is_rare)


def check_budget(false_alarms_per_hour: float) -> None:
    """Refuse a budget of false alarms that is too small or too large.

    Raises:
        ConfigError: It lies beyond the bounds, or is not a number.
    """
    if not LEAST_PER_HOUR <= false_alarms_per_hour <= MOST_PER_HOUR:
        given = f"the budget is {false_alarms_per_hour:g} false contacts per hour"
        raise ConfigError(f"{given}, valid are {LEAST_PER_HOUR:g} to {MOST_PER_HOUR:g}")


def unsettled(count: NDArray[np.int64]) -> int:
    """Return the number of windows of a camera's transient at the beginning of a recording.

    A camera may begin with a burst, while its pixels settle, or deliver nothing for a while. Blocks
    of a burst exceed the later half of the blocks. An empty beginning is a transient only if an
    even stream follows it, since a sensor without noise sends nothing, too.

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

        Raises:
            ConfigError: It has another length than the windows that the detector learned from; the
                last window of a stream may be shorter.
        """
        ...

    def reset(self) -> None:
        """Forget the past windows, but keep what was learned from the quiet ones."""
        ...

    def summary(self) -> DetectorSummary:
        """Return what the detector was built from, and its decision rule."""
        ...
