"""One clock on another: a line, learned from moments that both have timed, or through a host."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.schema import build
from spikingtac.types import US_PER_S, FloatArray

PPM = 1e-6
DRIFT = 100 * PPM  # Largest drift between two clocks, s/s (two crystals of 50 ppm each).

# Shared moments further from the line than this are taken for mistakes (a good one of a hundred is
# that far off once in 160 times); standard deviation over median absolute deviation.
REJECTED_SIGMA, SIGMA_PER_MAD = 4.0, 1.4826
MOST_FOR_PAIRS = 600  # Moments whose pairs are looked at: there are half of its square.
LEAST_FOR_DRIFT = 3  # Moments from which on a drift has an error that can be told.
LEAST_TO_REJECT = 8  # Moments from which on some are left out: of fewer, which cannot be told.
ROUNDS_OF_MOMENTS = 4  # Rounds of leaving moments out; the second one changes little.
ONE_SIGMA = 0.8413  # Share of a normal distribution below one standard deviation.

BIN_S = 0.1  # Stretch of deliveries of which the fastest counts, s (one in a hundred is, at 1 kHz).
MOST_BINS = 4096  # Stretches that are kept: then neighbours are joined, so memory stays bounded.

LEAST_SPAN_S = 2.0  # Least span of a drift, s; below, jitter of 0.1 ms would pass for 50 ppm.
ROUNDS, LEAST_FASTEST = 4, 8  # Times that late arrivals are left out, and how many stay at least.

# Number of a stretch -> sensor time of its fastest arrival, and how late that was, s.
_Bins = dict[int, tuple[float, float]]


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

        By how much the fastest transports of two cameras differ, the error cannot hold: only
        something that both see can tell (:func:`through_moments`).
        """
        drift = (1.0 + self.drift_ppm * PPM) * (1.0 + other.drift_ppm * PPM) - 1.0
        errors_ppm = self.drift_error_ppm, other.drift_error_ppm
        return TimeMap(
            own_us=self.own_us,
            base_us=other.at(self.base_us),
            drift_ppm=drift / PPM,
            error_us=math.hypot(self.error_us, other.error_us),
            drift_error_ppm=None if None in errors_ppm else math.hypot(*filter(None, errors_ppm)),
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
        names = {field.name for field in fields(cls)} & document.keys()
        try:
            if not {"own_us", "base_us", "drift_ppm"} <= names:
                raise ConfigError(f"it names {', '.join(names) or 'nothing'}")
            return build(cls, {name: document[name] for name in names}, "time_base")
        except ConfigError as error:
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
    keep = _agreeing(own, shift)
    own, shift = own[keep], shift[keep]
    middle, count = float(own.mean()), len(own)
    spread = float(((own - middle) ** 2).sum())
    slope, scatter_us, drift_error_ppm = 0.0, float(np.ptp(shift)) / 2.0, None
    if count >= LEAST_FOR_DRIFT and spread > 0.0:
        from scipy.special import stdtrit  # not loaded by those who read one clock

        slope = float(np.polyfit(own - middle, shift - shift[0], 1)[0])
        rest = shift - slope * (own - middle)
        # Few moments tell their own scatter badly: the quantile of Student's t widens it.
        scatter_us = float(rest.std(ddof=2)) * float(stdtrit(count - 2, ONE_SIGMA))
        drift_error_ppm = max(scatter_us, floor_us) / math.sqrt(spread) / PPM
    return TimeMap(
        own_us=middle,
        base_us=middle + float(shift.mean()),
        drift_ppm=slope / PPM,
        error_us=max(scatter_us, floor_us) / math.sqrt(count),
        drift_error_ppm=drift_error_ppm,
        learned_from=learned_from,
    )


def _agreeing(own: FloatArray, shift: FloatArray) -> NDArray[np.bool_]:
    """Return which moments lie near the line through most of them."""
    keep = np.ones(len(own), bool)
    if len(own) < LEAST_TO_REJECT or not np.ptp(own):
        return keep
    # The median of the slopes of all pairs, which a quarter of mistakes cannot move.
    some = np.linspace(0, len(own) - 1, min(len(own), MOST_FOR_PAIRS)).astype(np.intp)
    apart, rise = (np.subtract.outer(of[some], of[some]) for of in (own, shift))
    slope = float(np.median(rise[apart > 0.0] / apart[apart > 0.0]))
    for _ in range(ROUNDS_OF_MOMENTS):
        rest = shift - slope * own
        rest -= np.median(rest[keep])
        sigma = SIGMA_PER_MAD * float(np.median(np.abs(rest[keep])))
        fewer = np.abs(rest) <= max(REJECTED_SIGMA * sigma, 1.0)
        if np.count_nonzero(fewer) < LEAST_FOR_DRIFT or not np.ptp(own[fewer]):
            break
        keep = fewer
        slope = np.polyfit(own[keep] - own[keep][0], shift[keep] - shift[keep][0], 1)[0]
    return keep


class ClockFit:
    """Learns a sensor's clock on its host's while deliveries come, at constant memory.

    No delivery is faster than the fastest transport. So the least differences between arrival and
    sensor time follow a line: its slope is the drift, its height the offset plus that transport,
    which no one-way stream can tell apart. The error states how well the line is known.
    """

    def __init__(self) -> None:
        self._bin_s = BIN_S
        self._zero_s: float | None = None
        self._bins: _Bins = {}  # another thread may copy it meanwhile

    def arrived(self, t_us: int, host_s: float) -> None:
        """Learn from a delivery.

        Args:
            t_us: Time of its last event, us.
            host_s: When it was here, on the monotonic clock, s.
        """
        sensor_s = t_us / US_PER_S
        if self._zero_s is None:
            self._zero_s = sensor_s
        number = int((sensor_s - self._zero_s) / self._bin_s)
        _keep_fastest(self._bins, number, (sensor_s, host_s - sensor_s))
        if len(self._bins) >= MOST_BINS:
            self._bin_s *= 2.0
            joined: _Bins = {}
            for number, arrival in self._bins.items():
                _keep_fastest(joined, number // 2, arrival)
            self._bins = joined

    def forget(self) -> None:
        """Begin anew: the sensor's clock was set."""
        self.__init__()

    def mapping(self) -> TimeMap | None:
        """Return what is known; None before the first delivery."""
        bins = self._bins.copy()
        if not bins:
            return None
        sensor_s, delay_s = np.array([*bins.values()]).T
        # What came later than the clocks drift apart had waited, or is of before a leap.
        prompt = delay_s <= delay_s.min() + BIN_S + DRIFT * np.ptp(sensor_s)
        sensor_s, delay_s = sensor_s[prompt], delay_s[prompt]
        middle_s, span_s = float(sensor_s.mean()), float(sensor_s[-1] - sensor_s[0])
        if span_s >= LEAST_SPAN_S:
            return _fastest_line(sensor_s - middle_s, delay_s, middle_s, span_s)
        spread_us = float(delay_s.std()) * US_PER_S
        return TimeMap(
            own_us=middle_s * US_PER_S,
            base_us=(middle_s + float(delay_s.min())) * US_PER_S,
            error_us=spread_us,
            jitter_us=spread_us,
            span_s=span_s,
        )


def _keep_fastest(bins: _Bins, number: int, arrival: tuple[float, float]) -> None:
    if number not in bins or arrival[1] < bins[number][1]:
        bins[number] = arrival


def _fastest_line(x: FloatArray, delay_s: FloatArray, middle_s: float, span_s: float) -> TimeMap:
    """Fit a line to the fastest arrivals: the late half of those above it is left out each time."""
    base_s = float(delay_s[0])
    y, keep = delay_s - base_s, np.ones(len(x), bool)
    slope, height = np.polyfit(x, y, 1)
    for _ in range(ROUNDS):
        above = y - (slope * x + height)
        fewer = keep & (above <= np.median(above[keep]))
        if np.count_nonzero(fewer) < LEAST_FASTEST:
            break
        keep = fewer
        slope, height = np.polyfit(x[keep], y[keep], 1)
    rest, count = y[keep] - (slope * x[keep] + height), int(np.count_nonzero(keep))
    jitter_s = float(np.sqrt((rest**2).sum() / max(count - 2, 1)))
    spread = float(((x[keep] - x[keep].mean()) ** 2).sum())
    return TimeMap(
        own_us=middle_s * US_PER_S,
        base_us=(middle_s + base_s + float(height)) * US_PER_S,
        drift_ppm=float(slope) / PPM,
        error_us=jitter_s / math.sqrt(count) * US_PER_S,
        drift_error_ppm=jitter_s / math.sqrt(spread) / PPM if spread else None,
        jitter_us=jitter_s * US_PER_S,
        span_s=span_s,
    )
