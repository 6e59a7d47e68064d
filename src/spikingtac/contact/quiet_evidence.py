"""Distribution of the evidence without contact, estimated while the arm moves, and its thresholds.

A threshold that is exceeded once in a stated time is extrapolated from a much shorter recording.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import (
    SECONDS_PER_HOUR,
    Period,
    QuietStatistics,
    Window,
    packets_of,
)
from spikingtac.contact.evidence import (
    AFFINE_MODES,
    BESIDE,
    MODES,
    OFF_RIM,
    POLARITIES,
    RimTable,
    ScaleSums,
    ScaleTest,
    evidence_of,
)
from spikingtac.errors import CalibrationError
from spikingtac.types import FloatArray

# Shares of the highest blocks that form the tail. Rare swings of an arm exceed the noise of the
# pixels only in the outermost blocks. Each share gives a threshold; the highest is used.
TAIL_SHARES = (0.05, 0.02, 0.01)

# Fewest blocks in the tail of the first share, which a short recording uses too, and of the other
# shares. Their mean excess then has a standard error of a third and of two fifths.
WHOLE_TAIL, LEAST_TAIL = 10, 6
STANDARD_ERRORS = 2.0  # The mean excess is raised by this many of its standard errors.


def tail_threshold(values: FloatArray, block: int, per_block: float) -> float:
    """Return the value that a block's highest value exceeds with a small probability.

    The excess of the blocks' maxima over a high quantile is taken as exponential (Pickands, Ann.
    Statist. 3, 1975, with shape 0). For an amplitude of Gaussian origin, such as that of a
    vibration, this overstates the tail; where noise makes most of the maxima and something else the
    highest, one quantile would understate it, so that several are tried. The mean excess is raised
    by two standard errors: a short recording gives a high threshold, not a wrong one.

    Args:
        values: An amplitude at consecutive times.
        block: Length of a block; values further apart are taken as independent.
        per_block: The probability.

    Returns:
        The threshold; infinity where there are fewer than two blocks.
    """
    blocks = len(values) // block
    peaks = np.sort(values[: blocks * block].reshape(blocks, block).max(axis=1))
    whole = min(max(round(TAIL_SHARES[0] * blocks), WHOLE_TAIL), blocks - 1)
    if whole < 1:
        return math.inf
    further = [round(share * blocks) for share in TAIL_SHARES[1:]]
    tails = [whole, *(tail for tail in further if tail >= LEAST_TAIL)]
    return max(_extrapolated(peaks, tail, per_block) for tail in tails)


def _extrapolated(peaks: FloatArray, tail: int, per_block: float) -> float:
    """Return the threshold that the highest ``tail`` of the sorted peaks give."""
    level = float(peaks[-tail - 1])
    excess = float(peaks[-tail:].mean()) - level
    excess *= 1.0 + STANDARD_ERRORS / math.sqrt(tail)
    return level + excess * math.log(max(tail / len(peaks) / per_block, 1.0))


# Fewest sums of a scale in the quiet windows for its use: all nine scales from 1.8 s on.
LEAST_SUMS = 7
MEMORY_S = 0.1  # Time constant of the arm's vibration, s: Q / (pi f) at 15 Hz and Q = 5.


# Largest number of time scales, of 1, 2, 4, ... windows: up to 256 ms, in which the tip travels
# 0.2 mm at 0.8 mm/s. A short quiet recording allows for fewer.
SCALES = 9

# Pixels with more events per second are ignored, Hz (the twin's hot pixels fire at 10 to 500, its
# background at 1).
HOT_HZ = 8.0

# Prior events of each polarity, anywhere on the rims: the quiet windows of a sensor without noise
# hold too few events to estimate the covariance. (Of a Poisson process that shows no event, the
# expected number is below 3 with a confidence of 95 %.)
PRIOR_EVENTS = 3.0

# Events of which at least one must lie on a rim: rims cover a tenth of the sensor.
RIM_EVENTS = 100

# Largest imbalance of the leak between opposite directions, as a share of all leak events: after
# a contact one side of each rim is closer to its threshold (measured on the twin, 1 s after one).
LEAK_BIAS = 0.5


@dataclass(frozen=True, slots=True)
class QuietEvidence:
    """The evidence of the quiet windows.

    Attributes:
        tables: The rims without hot pixels.
        evidence: ``(n, length)`` evidence of each window.
        hot_pixels: How many hot pixels of each sensor's rims are ignored.
        statistics: Counts of all events of the windows.
    """

    tables: tuple[RimTable, ...]
    evidence: FloatArray
    hot_pixels: tuple[int, ...]
    statistics: QuietStatistics


def quiet_evidence(tables: Sequence[RimTable], quiet: Iterable[Window]) -> QuietEvidence:
    """Find the hot pixels of a quiet recording and sum its evidence without them.

    Raises:
        CalibrationError: The recording is too short, or no marker lies on the sensor.
        ConfigError: The windows come from a sensor of another size than the calibrations, or differ
            in length.
    """
    if not all(len(table.modes) for table in tables):
        raise CalibrationError(
            "no rim of a marker lies on the sensor; calibrate it anew: "
            "spikingtac calibrate RECORDING -o calibration.json"
        )
    fired = [np.zeros(table.row.shape, np.int64) for table in tables]
    kept, beside, counts, period = [], [], [], Period()
    for window in quiet:
        packets = packets_of(window)
        counts.append(period.count(window))
        beside.append(evidence_of(window, tables)[BESIDE::MODES])
        pairs = zip(packets, tables, strict=True)
        rims = tuple(one.select(table.row[one.y, one.x] != OFF_RIM) for one, table in pairs)
        for rim, times in zip(rims, fired, strict=True):
            np.add.at(times, (rim.y, rim.x), 1)
        kept.append(rims)  # a tenth of the events
    statistics = QuietStatistics.of_counts(counts, period.us * 1e-6)
    _require_evidence(counts, fired)
    limit = max(HOT_HZ * len(kept) * statistics.period_s, 1.0)
    hot = [times > limit for times in fired]  # events on the rims only were counted
    clean = tuple(table.without(mask) for table, mask in zip(tables, hot, strict=True))
    evidence = np.array([evidence_of(window, clean) for window in kept])
    evidence[:, BESIDE::MODES] = beside  # only events on the rims were kept
    return QuietEvidence(
        tables=clean,
        evidence=evidence,
        hot_pixels=tuple(int(mask.sum()) for mask in hot),
        statistics=statistics,
    )


def _require_evidence(counts: list[int], fired: list[NDArray[np.int64]]) -> None:
    few = 0 < sum(counts) < RIM_EVENTS
    if not few and not any(times.any() for times in fired):
        raise CalibrationError(
            f"none of the {sum(counts)} events of {len(counts)} quiet windows lies on the markers' "
            "rims: check the camera, and whether the calibration is this sensor's"
        )


def scale_test(quiet: QuietEvidence, alarms_per_hour: float) -> ScaleTest:
    """Return the test of every scale; the scales share the false-alarm budget evenly.

    Raises:
        CalibrationError: The quiet windows hold too few events on the markers' rims, or two markers
            share one place.
    """
    # Loaded when needed, since configurations import this module; scipy.stats would take 0.6 s.
    from scipy.special import chdtri, pdtrik

    windows = 2 ** np.arange(SCALES)
    windows = windows[windows * LEAST_SUMS <= len(quiet.evidence)]
    mean, power = quiet.evidence.mean(axis=0), _event_power(quiet)
    sums = np.concatenate([np.zeros((1, len(mean))), np.cumsum(quiet.evidence - mean, axis=0)])
    try:
        whiten = np.stack([_whitening(sums, quiet, int(n), power) for n in windows])
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "the quiet windows do not tell motions apart: too few events lie on the markers' rims, "
            "or markers share one place; check the calibration, and record the moving arm"
        ) from error
    event = np.array([_one_event(part, power) for part in whiten])
    rims = max(len(table.modes) / max((table.row == OFF_RIM).sum(), 1) for table in quiet.tables)
    chance = rims * np.sqrt(event / whiten.shape[1])
    # The light of the quiet windows is part of their amplitude.
    replayed = ScaleSums(ScaleTest(windows, whiten, 0.0 * chance, mean, mean))
    amplitude = np.sqrt([replayed.add(window).copy() for window in quiet.evidence])
    per_window = alarms_per_hour * quiet.statistics.period_s / SECONDS_PER_HOUR / len(windows)
    floor = float(chdtri(whiten.shape[1], per_window))  # chi squared, inverse survival
    memory = round(MEMORY_S / quiet.statistics.period_s)
    threshold = []
    for scale, length in enumerate(windows):
        block = max(memory, int(length))
        tail = tail_threshold(amplitude[int(length) - 1 :, scale], block, per_window * block) ** 2
        # So many events of a polarity that was not seen may come by chance, all for one motion.
        unseen = math.ceil(pdtrik(1.0 - per_window, PRIOR_EVENTS * length / len(quiet.evidence)))
        threshold.append(max(tail, floor, unseen**2 * event[scale]))
    raised = _at_least_shorter(np.array(threshold), whiten)
    if not np.isfinite(raised).all():
        raise CalibrationError(
            f"{len(quiet.evidence)} quiet windows are too few for a threshold: it takes 0.3 s; "
            "record the moving arm for longer (a minute is good)"
        )
    return ScaleTest(windows, whiten, chance, mean, raised)


def _at_least_shorter(threshold: FloatArray, whiten: FloatArray) -> FloatArray:
    """Raise thresholds to what a sum makes of a shorter one that is just below its own.

    A swing of the arm that is rare at a short scale is part of every longer sum too, at a level
    that a minute of quiet may not have shown at the longer scale.
    """
    raised = threshold.copy()
    for scale in range(1, len(raised)):
        share = np.linalg.norm(whiten[scale] @ np.linalg.pinv(whiten[scale - 1]), 2)
        raised[scale] = max(raised[scale], share**2 * raised[scale - 1])
    return raised


def _whitening(
    sums: FloatArray, quiet: QuietEvidence, windows: int, power: FloatArray
) -> FloatArray:
    """Return ``(d, length)``: join the polarities, then scale to unit variance at most.

    Motion fires ON and OFF events alike, the leak only ON events. The ON evidence is therefore
    weighted by what the leak may have added over this time.
    """
    unseen = PRIOR_EVENTS / len(quiet.evidence) * np.repeat(power, POLARITIES, axis=0)
    covariance = np.cov(quiet.evidence.T) + np.diag(unseen.ravel())
    bias = _leak_bias(quiet, power[:, :AFFINE_MODES])
    columns = np.arange(len(covariance)).reshape(-1, POLARITIES, MODES)[..., :AFFINE_MODES]
    off, on = columns[:, 0].ravel(), columns[:, 1].ravel()
    variance = np.diag(covariance) + np.finfo(float).tiny
    rows = np.arange(len(on))
    joined = np.zeros((len(on), len(covariance)))
    joined[rows, off] = 1.0 / variance[off]
    joined[rows, on] = 1.0 / (variance[on] + windows * bias**2)
    expected = windows * joined @ covariance @ joined.T
    expected += np.diag((windows * bias * joined[rows, on]) ** 2)
    half = np.linalg.inv(np.linalg.cholesky(expected)) @ joined
    # Directions in which the quiet sums vary more than expected, because of bursts, are shrunk.
    stride = max(windows // 4, 1)
    spread = (sums[windows::stride] - sums[:-windows:stride]) @ half.T
    value, axes = np.linalg.eigh(spread.T @ spread / max(len(spread), 1))
    return (axes / np.sqrt(np.maximum(value, 1.0))).T @ half


def _event_power(quiet: QuietEvidence) -> FloatArray:
    """Return ``(sensors, MODES)`` the mean square of what one event adds to the evidence."""
    rims = (table.modes[table.row[table.row != OFF_RIM]] for table in quiet.tables)
    return np.stack([np.append((modes**2).mean(axis=0), 0.0) for modes in rims])


def _one_event(whiten: FloatArray, power: FloatArray) -> float:
    """Return the mean whitened square of one event, of the polarity where that is larger."""
    power = np.repeat(power, POLARITIES, axis=0)
    return float((np.square(whiten).sum(axis=0).reshape(power.shape) * power).sum(axis=1).max())


def _leak_bias(quiet: QuietEvidence, power: FloatArray) -> FloatArray:
    """Return evidence per window and mode ``(d,)`` that the leak may add in one direction.

    Args:
        quiet: Its evidence.
        power: ``(sensors, modes)`` mean square of what one event adds to it.
    """
    variance = quiet.evidence.var(axis=0).reshape(-1, POLARITIES, MODES)[..., :AFFINE_MODES]
    events = variance.mean(axis=2) / power.mean(axis=1, keepdims=True)
    return (LEAK_BIAS * np.sqrt(power) * np.maximum(events[:, 1:] - events[:, :1], 0.0)).ravel()
