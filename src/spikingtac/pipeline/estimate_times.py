"""The times at which the markers are estimated, for recordings and live streams alike."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from spikingtac.errors import ConfigError

LARGEST_RATE_HZ = 1.0e6
"""Events carry microseconds; no estimate can be asked for more often."""


@dataclass(frozen=True, slots=True)
class EstimateTimes:
    """The times ``t_k = first_us + floor(k * 1e6 / rate_hz)``, k = 0, 1, 2, ...

    Attributes:
        first_us: Time of the stream's first event, us.
        rate_hz: Estimates per second of data time.

    Example:
        >>> list(itertools.islice(EstimateTimes(400, 350.0), 3))
        [400, 3257, 6114]
    """

    first_us: int
    rate_hz: float

    def __post_init__(self) -> None:
        check_rate(self.rate_hz)

    def at(self, index: int) -> int:
        """Return the time of an estimate, us."""
        return self.first_us + int(index * 1e6 // self.rate_hz)

    def since(self, t_us: int) -> Iterator[int]:
        """Yield the times from the last one at or before ``t_us`` on, without end."""
        return map(self.at, itertools.count(self.index(t_us)))

    def includes(self, t_us: int) -> bool:
        """Return whether an estimate is due at ``t_us``."""
        return self.at(self.index(t_us)) == t_us

    def index(self, t_us: int) -> int:
        """Return the index of the last time at or before ``t_us``, or 0."""
        index = max(int((t_us - self.first_us) * self.rate_hz / 1e6) - 1, 0)
        while self.at(index + 1) <= t_us:
            index += 1
        return index

    def __iter__(self) -> Iterator[int]:
        """Yield the times without end."""
        return map(self.at, itertools.count())


def check_rate(rate_hz: float) -> None:
    """Refuse a rate at which no stream can be tracked.

    Raises:
        ConfigError: The rate is not between 0 and 1 MHz.
    """
    if not 0.0 < rate_hz <= LARGEST_RATE_HZ:
        raise ConfigError(f"rate_hz is {rate_hz:g}, it must be above 0 and at most 1e6")
