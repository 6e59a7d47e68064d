"""One clock on another: a line, learned from moments that both have timed, or through a host."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError

PPM = 1e-6
US_PER_S = 1e6

# Shared moments further from the line than this are taken for mistakes (with a hundred of
# them a good one is that far off by chance once in 160 times).
REJECTED_SIGMA = 4.0

# Standard deviation over median absolute deviation of a normal distribution.
SIGMA_PER_MAD = 1.4826
MOST_FOR_PAIRS = 600  # Moments whose pairs are looked at: there are half of its square.
LEAST_FOR_DRIFT = 3  # Moments from which on a drift has an error that can be told.

# Moments from which on some are left out: of fewer, which one is mistaken cannot be told.
LEAST_TO_REJECT = 8
MOST_ROUNDS = 50  # Rounds of leaving moments out: those at the very limit may come and go for ever.
ONE_SIGMA = 0.8413  # Share of a normal distribution below one standard deviation.


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeMap:
    """Time on the base = ``base_us`` + (time - ``own_us``) x (1 + drift).

    The base may be a host's monotonic clock; then it holds the fastest transport.

    Attributes:
        own_us: A moment on the mapped clock, us: the middle of those that the map is learned from.
        base_us: The same moment on the base clock, us.
        drift_ppm: How much faster the base clock runs, parts per million.
        error_us: Standard error of a mapped time at that moment, us.
        drift_error_ppm: Standard error of the drift; None where none could be learned.
        learned_from: ``host`` (arrivals at one host), ``triggers`` (a line that both timed) or
            ``taps``.
        jitter_us: Root mean square of the fastest arrivals about the line, us.
        span_s: Stretch of time that it is learned from, where that is known, s.
    """

    own_us: float = 0.0
    base_us: float = 0.0
    drift_ppm: float = 0.0
    error_us: float = 0.0
    drift_error_ppm: float | None = None
    learned_from: str = "host"
    jitter_us: float = 0.0
    span_s: float = 0.0

    def at(self, t_us: Any) -> Any:
        """Return a time, or an array of them, on the base clock, us."""
        return self.base_us + (t_us - self.own_us) * (1.0 + self.drift_ppm * PPM)

    def host_s(self, t_us: float) -> float:
        """Return a time on the base clock, s."""
        return self.at(t_us) / US_PER_S

    def __call__(self, t_us: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return ``(n,)`` times on the base clock, us; what was in order stays so."""
        return np.rint(self.at(t_us)).astype(np.int64)

    def inverse(self) -> TimeMap:
        """Return the map from the base clock to this one."""
        drift_ppm = (1.0 / (1.0 + self.drift_ppm * PPM) - 1.0) / PPM
        return replace(self, own_us=self.base_us, base_us=self.own_us, drift_ppm=drift_ppm)

    def then(self, other: TimeMap) -> TimeMap:
        """Return the map to the base of another map, whose own clock is this one's base.

        Of two clocks that one host has watched, the error is that of the two lines. What it cannot
        hold is by how much the fastest transports of the two cameras differ: only something that
        both see can tell (:func:`through_moments`).
        """
        drift = (1.0 + self.drift_ppm * PPM) * (1.0 + other.drift_ppm * PPM) - 1.0
        errors_ppm = [self.drift_error_ppm, other.drift_error_ppm]
        known = [error for error in errors_ppm if error is not None]
        return TimeMap(
            own_us=self.own_us,
            base_us=other.at(self.base_us),
            drift_ppm=drift / PPM,
            error_us=math.hypot(self.error_us, other.error_us),
            drift_error_ppm=math.hypot(*known) if len(known) == len(errors_ppm) else None,
        )

    def error_at_us(self, t_us: float) -> float:
        """Return the standard error of a mapped time, us: it grows away from the middle."""
        return math.hypot(self.error_us, (self.drift_error_ppm or 0.0) * PPM * (t_us - self.own_us))

    def summary(self) -> dict[str, Any]:
        """Return the map for a manifest."""
        return asdict(self)

    def clock_summary(self) -> dict[str, Any]:
        """Return a sensor's clock on its host's: time = offset + sensor time x (1 + drift)."""
        return {
            "offset_s": self.host_s(0.0),
            "drift_ppm": self.drift_ppm,
            "offset_error_us": self.error_us,
            "drift_error_ppm": self.drift_error_ppm,
            "jitter_us": self.jitter_us,
            "span_s": self.span_s,
            "middle_us": self.own_us,
        }

    @classmethod
    def from_clock(cls, document: Mapping[str, Any]) -> Self:
        """Return the map that :meth:`clock_summary` described; raises what a dict raises."""
        drift_ppm, middle_us = float(document["drift_ppm"]), float(document.get("middle_us", 0.0))
        return cls(
            own_us=middle_us,
            base_us=float(document["offset_s"]) * US_PER_S + middle_us * (1.0 + drift_ppm * PPM),
            drift_ppm=drift_ppm,
            error_us=float(document["offset_error_us"]),
            drift_error_ppm=document["drift_error_ppm"],
            jitter_us=float(document["jitter_us"]),
            span_s=float(document["span_s"]),
        )

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """Return the map that :meth:`summary` described.

        Raises:
            RecordingError: It describes none.
        """
        try:
            values = {name: document[name] for name in ("own_us", "base_us", "drift_ppm")}
            if not all(math.isfinite(value) for value in values.values()):
                raise ValueError("not finite")
            drift_error_ppm = document.get("drift_error_ppm")
            return cls(
                **{name: float(value) for name, value in values.items()},
                error_us=float(document.get("error_us", 0.0)),
                drift_error_ppm=None if drift_error_ppm is None else float(drift_error_ppm),
                learned_from=str(document.get("learned_from", "host")),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise RecordingError(f"the manifest's time_base cannot be read: {error}") from error


def through_moments(
    own_us: NDArray[Any], base_us: NDArray[Any], learned_from: str = "taps", floor_us: float = 0.0
) -> TimeMap:
    """Return the map through moments that both clocks have timed; outliers are left out.

    Args:
        own_us: ``(n,)`` times of the moments on the mapped clock, us; at least one.
        base_us: ``(n,)`` their times on the base clock, us.
        learned_from: What the moments are, for the map.
        floor_us: Least error of the map, us: how finely a moment is known.

    Raises:
        ConfigError: The arrays do not fit each other, or are empty.
    """
    own, base = np.asarray(own_us, np.float64), np.asarray(base_us, np.float64)
    if own.shape != base.shape or own.ndim != 1 or not len(own):
        raise ConfigError(
            f"{own.shape} moments of one clock were given for {base.shape} of the other; "
            "give at least one, in pairs"
        )
    shift = base - own
    slope, keep = _line(own, shift)
    middle = float(own[keep].mean())
    rest = shift[keep] - slope * (own[keep] - middle)
    count = int(np.count_nonzero(keep))
    spread = float(((own[keep] - middle) ** 2).sum())
    with_drift = count >= LEAST_FOR_DRIFT and spread > 0.0
    scatter_us = float(rest.std(ddof=2)) if with_drift else float(np.ptp(rest)) / 2.0
    if with_drift:  # few moments tell their own scatter badly
        from scipy.special import stdtrit  # not loaded by those who read one clock

        scatter_us *= float(stdtrit(count - 2, ONE_SIGMA))
    scatter_us = max(scatter_us, floor_us)
    return TimeMap(
        own_us=middle,
        base_us=middle + float(rest.mean()),
        drift_ppm=slope / PPM,
        error_us=scatter_us / math.sqrt(count),
        drift_error_ppm=scatter_us / math.sqrt(spread) / PPM if with_drift else None,
        learned_from=learned_from,
    )


def _line(own: NDArray[np.float64], shift: NDArray[np.float64]) -> tuple[float, NDArray[np.bool_]]:
    """Return the slope of the shifts over time, and which moments agree with it."""
    stats: Any = import_module("scipy.stats")  # not loaded by those who read one clock

    keep = np.ones(len(own), bool)
    if len(own) < LEAST_FOR_DRIFT or not np.ptp(own):
        return 0.0, keep
    if len(own) < LEAST_TO_REJECT:
        return stats.linregress(own, shift).slope, keep
    # The median of the slopes of all pairs, which a quarter of mistakes cannot move.
    some = np.linspace(0, len(own) - 1, min(len(own), MOST_FOR_PAIRS)).astype(np.intp)
    slope = stats.theilslopes(shift[some], own[some]).slope
    for _ in range(MOST_ROUNDS):
        rest = shift - slope * own
        rest -= np.median(rest[keep])
        sigma = SIGMA_PER_MAD * float(np.median(np.abs(rest[keep])))
        fewer = np.abs(rest) <= max(REJECTED_SIGMA * sigma, 1.0)
        if np.count_nonzero(fewer) < LEAST_FOR_DRIFT or not np.ptp(own[fewer]):
            return slope, keep
        refined = stats.linregress(own[fewer], shift[fewer]).slope
        if (fewer == keep).all():
            return refined, keep
        keep, slope = fewer, refined
    return slope, keep
