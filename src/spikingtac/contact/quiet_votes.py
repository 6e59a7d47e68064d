"""Learn from the moving arm what votes look like without contact."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from spikingtac.contact.detector import Window, packets_of
from spikingtac.contact.rim_votes import AFFINE_MODES, OFF_RIM, RimTable
from spikingtac.contact.scales import ScaleSums, ScaleTest
from spikingtac.contact.tail import tail_threshold
from spikingtac.contact.vote_counter import POLARITIES, VoteCounter
from spikingtac.errors import CalibrationError
from spikingtac.types import EventPacket

Vector = NDArray[np.float64]

SECONDS_PER_HOUR = 3600.0
LEAST_WINDOWS = 200
"""The covariance of the votes of one window needs ten windows per number (12 per sensor)."""
LEAST_SUMS = 7
"""A scale is used where the quiet windows hold so many of its sums: all nine from 1.8 s on."""

MEMORY_S = 0.1
"""How long an arm remembers its vibration, s: Q / (pi f) at 15 Hz and Q = 5."""


@dataclass(frozen=True, kw_only=True)
class LearningConfig:
    """How the test is made from quiet windows.

    Attributes:
        scales: Most time scales, of 1, 2, 4, ... windows (9: up to 256 ms, in which the tip
            travels 0.2 mm at 0.8 mm/s); a short quiet recording allows for fewer.
        hot_hz: Pixels with more events a second are taken out (the twin's hot pixels fire at 10 to
            500 Hz, its background at 1 Hz).
        leak_bias: By how much the leak may vote for one direction, as a share of all leak events:
            after a contact one side of each rim is closer to its threshold than the other. Measured
            on the twin one second after a release: 0.5.
    """

    scales: int = 9
    hot_hz: float = 8.0
    leak_bias: float = 0.5

    def __post_init__(self) -> None:
        if self.scales < 1 or not self.hot_hz > 0.0 or self.leak_bias < 0.0:
            raise ValueError("scales and hot_hz must be positive, leak_bias not negative")


@dataclass(frozen=True, slots=True)
class QuietVotes:
    """What the quiet windows taught.

    Attributes:
        tables: The rims without hot pixels.
        votes: ``(n, length)`` votes of each window.
        period_s: Length of a window, s.
        hot_pixels: How many pixels were taken out of each sensor's rims.
    """

    tables: tuple[RimTable, ...]
    votes: Vector
    period_s: float
    hot_pixels: tuple[int, ...]

    def marker_noise(self, sensor: int) -> float:
        """Return the mean squared length of one marker's votes in one window.

        The first two modes sum the votes of all markers along x and y.
        """
        both = self.votes.reshape(len(self.votes), -1, POLARITIES, AFFINE_MODES)[:, sensor, :, :2]
        markers = len(self.tables[sensor].center_px)
        return float(both.sum(axis=1).var(axis=0).sum()) / markers


def quiet_votes(
    tables: Sequence[RimTable], quiet: Iterable[Window], config: LearningConfig
) -> QuietVotes:
    """Find the hot pixels of a quiet recording and count its votes without them.

    Raises:
        CalibrationError: The recording is too short.
    """
    kept, counts, period_s = _on_rims(tables, quiet)
    if len(kept) < LEAST_WINDOWS:
        raise CalibrationError(
            f"{len(kept)} quiet windows are too few for the default detector, at least "
            f"{LEAST_WINDOWS} are needed; record the moving arm for longer (a minute is good)"
        )
    limit = max(config.hot_hz * len(kept) * period_s, 1.0)
    hot = [
        (count > limit) & (table.row != OFF_RIM)
        for count, table in zip(counts, tables, strict=True)
    ]
    clean = tuple(table.without(mask) for table, mask in zip(tables, hot, strict=True))
    counter = VoteCounter(clean, memory=1)
    votes = np.array([counter.count(window).copy() for window in kept])
    return QuietVotes(clean, votes, period_s, tuple(int(mask.sum()) for mask in hot))


def scale_test(quiet: QuietVotes, config: LearningConfig, alarms_per_hour: float) -> ScaleTest:
    """Return the test of every scale that shares out a false-alarm budget evenly among them."""
    windows = 2 ** np.arange(config.scales)
    windows = windows[windows * LEAST_SUMS <= len(quiet.votes)]
    mean = quiet.votes.mean(axis=0)
    sums = np.concatenate([np.zeros((1, len(mean))), np.cumsum(quiet.votes - mean, axis=0)])
    whiten = np.stack([_whitening(sums, quiet, int(n), config.leak_bias) for n in windows])
    untested = ScaleTest(windows, whiten, mean, np.full(len(windows), np.inf))
    amplitude = np.sqrt(_replay(untested, quiet.votes))
    per_window = alarms_per_hour * quiet.period_s / SECONDS_PER_HOUR / len(windows)
    floor = float(stats.chi2.isf(per_window, whiten.shape[1]))
    memory = round(MEMORY_S / quiet.period_s)
    threshold = []
    for scale, length in enumerate(windows):
        block = max(memory, int(length))
        known = amplitude[int(length) - 1 :, scale]
        found = tail_threshold(known, block, per_window * block)
        threshold.append(max(found**2, floor))
    return ScaleTest(windows, whiten, mean, _holding_shorter(np.array(threshold), whiten))


def _holding_shorter(threshold: Vector, whiten: Vector) -> Vector:
    """Raise thresholds to what a sum makes of a shorter one that is just below its own.

    A swing of the arm that is rare at a short scale is within every longer sum, too, at a level
    that a minute of quiet may not have shown there.
    """
    raised = threshold.copy()
    for scale in range(1, len(raised)):
        share = np.linalg.norm(whiten[scale] @ np.linalg.pinv(whiten[scale - 1]), 2)
        raised[scale] = max(raised[scale], share**2 * raised[scale - 1])
    return raised


def _replay(test: ScaleTest, votes: Vector) -> Vector:
    sums = ScaleSums(test)
    return np.array([sums.add(window).copy() for window in votes])


def _whitening(sums: Vector, quiet: QuietVotes, windows: int, leak_bias: float) -> Vector:
    """Return ``(d, length)``: join the polarities, then scale to unit variance at most.

    Motion fires ON and OFF alike, the leak ON alone: what the leak may have added over this time
    decides how much the ON votes count.
    """
    covariance = np.cov(quiet.votes.T)
    bias = _leak_bias(quiet, leak_bias)
    on, off = _columns(len(covariance), 1), _columns(len(covariance), 0)
    variance = np.diag(covariance) + np.finfo(float).tiny
    joined = np.zeros((len(on), len(covariance)))
    rows = np.arange(len(on))
    joined[rows, off] = 1.0 / variance[off]
    joined[rows, on] = 1.0 / (variance[on] + windows * bias**2)
    drift = np.zeros(len(covariance))
    drift[on] = (windows * bias) ** 2
    expected = joined @ (windows * covariance + np.diag(drift)) @ joined.T
    half = np.linalg.inv(np.linalg.cholesky(expected)) @ joined
    return _inflated(half, sums, windows)


def _inflated(whiten: Vector, sums: Vector, windows: int) -> Vector:
    """Shrink the directions in which the quiet sums vary more than was expected: bursts."""
    stride = max(windows // 4, 1)
    spread = (sums[windows::stride] - sums[:-windows:stride]) @ whiten.T
    value, axes = np.linalg.eigh(spread.T @ spread / max(len(spread), 1))
    return (axes / np.sqrt(np.maximum(value, 1.0))).T @ whiten


def _leak_bias(quiet: QuietVotes, share: float) -> Vector:
    """Return votes per window and mode ``(d,)`` that the leak may add in one direction."""
    out = []
    for sensor, table in enumerate(quiet.tables):
        used = table.row[table.row != OFF_RIM]
        power = (table.modes[used] ** 2).mean(axis=0)
        block = quiet.votes[:, POLARITIES * AFFINE_MODES * sensor :][:, : POLARITIES * AFFINE_MODES]
        variance = block.var(axis=0).reshape(POLARITIES, AFFINE_MODES)
        events = variance.mean(axis=1) / power.mean()
        out.append(share * max(events[1] - events[0], 0.0) * np.sqrt(power))
    return np.concatenate(out)


def _columns(length: int, polarity: int) -> NDArray[np.int64]:
    """Return where the votes of one polarity stand, over all sensors and modes."""
    places = np.arange(length).reshape(-1, POLARITIES, AFFINE_MODES)
    return places[:, polarity].ravel()


def _on_rims(
    tables: Sequence[RimTable], quiet: Iterable[Window]
) -> tuple[list[tuple[EventPacket, ...]], list[NDArray[np.int64]], float]:
    """Keep the events on the rims, a tenth of all; count the events of each pixel."""
    counts = [np.zeros(table.row.shape, np.int64) for table in tables]
    kept, period_us = [], 0
    for window in quiet:
        packets = packets_of(window)
        period_us = packets[0].t_end_us - packets[0].t_start_us
        parts = []
        for packet, table, count in zip(packets, tables, counts, strict=True):
            rim = packet.select(table.row[packet.y, packet.x] != OFF_RIM)
            np.add.at(count, (rim.y, rim.x), 1)
            parts.append(rim)
        kept.append(tuple(parts))
    return kept, counts, period_us * 1e-6
