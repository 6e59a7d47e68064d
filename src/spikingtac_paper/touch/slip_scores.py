"""Scores of slip alarms against the true share of a contact that sticks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac_paper.harness.report import Metric

Field = NDArray[np.float64]
Times = NDArray[np.int64]

GROSS_SHARE = 0.05
"""Sticking share below which the whole contact slips."""
EARLY_SHARE = 0.35
"""Share from which on a gross slip may be noticed however early; before, it must come within
100 ms."""
LATE_US = 10_000
"""Delay up to which a gross slip is noticed in time, us."""
LEAD_US = 20_000
"""Time by which an incipient slip must come before the gross one, us."""
HELD_SHARE = 0.98
"""Share of a contact that holds: what was told before it held last announces nothing."""
EARLIER_US = 100_000
"""Time before that in which an alarm still belongs to this slip, us."""
STICKS_SHARE = 0.85
"""An incipient slip is a false alarm where more sticks all the while: 20 ms before to 300 after."""
FALSE_GROSS_SHARE = 0.3
"""A gross slip is a false alarm where more sticks all the while: 20 ms before to 100 after."""
BEFORE_US, AFTER_INCIPIENT_US, AFTER_GROSS_US = 20_000, 300_000, 100_000
STICKING_SHARE = 0.9
"""Share from which a contact counts as sticking: false alarms per ten minutes are counted over it.
What is told between the two shares is told of a contact that slips in part: early, if not right."""
US_PER_MS, US_PER_S = 1e3, 1e6
METRICS = (
    Metric("gross_in_time", "1", "share of first gross slips noticed until 10 ms after they begin"),
    Metric("gross_delay_ms", "ms", "delay of those noticed at all; negative is early"),
    Metric("lead_20ms", "1", "share of the slides below 20 mm/s told 20 ms before it"),
    Metric("false_incipient", "alarms", "incipient slips told while 85 % and more stick", "sum"),
    Metric("false_incipient_sticking", "alarms", "of these, told while 90 % and more stick", "sum"),
    Metric("false_gross", "alarms", "gross slips told while 30 % and more stick", "sum"),
    Metric("false_gross_sticking", "alarms", "of these, told while 90 % and more stick", "sum"),
    Metric("sticking_s", "s", "time in which contacts stuck", "sum"),
)


@dataclass(frozen=True, slots=True)
class Truth:
    """What sticks, frame by frame.

    Attributes:
        t_us: ``(n,)`` times, us.
        share: ``(n,)`` share of the contact that sticks; nan where little touches.
        judged: ``(n,)`` frames in which alarms are judged.
        slow: Whether an incipient slip must be told 20 ms ahead.
    """

    t_us: Times
    share: Field
    judged: NDArray[np.bool_]
    slow: bool


def slip_scores(truth: Truth, incipient: Sequence[int], gross: Sequence[int]) -> dict[str, float]:
    """Compare alarms, us, with the truth of one contact.

    Of its gross slips only the first is scored: the later ones of a body that turns back or is
    dragged twice are not.
    """
    stuck = np.where(np.isfinite(truth.share), truth.share, 1.0)
    sticks = truth.judged & (stuck > STICKING_SHARE)
    frame_s = float(np.median(np.diff(truth.t_us))) / US_PER_S
    early, late = (incipient, AFTER_INCIPIENT_US), (gross, AFTER_GROSS_US)
    scores = {
        "false_incipient": _false(truth, stuck, *early, STICKS_SHARE),
        "false_incipient_sticking": _false(truth, stuck, *early, STICKING_SHARE),
        "false_gross": _false(truth, stuck, *late, FALSE_GROSS_SHARE),
        "false_gross_sticking": _false(truth, stuck, *late, STICKING_SHARE),
        "sticking_s": float(sticks.sum()) * frame_s,
    }
    slipped = np.flatnonzero(truth.judged & (stuck < GROSS_SHARE))
    if not len(slipped):
        return scores
    first = int(slipped[0])
    slip_us = int(truth.t_us[first])
    early_us = slip_us - AFTER_GROSS_US
    noticed = [t_us for t_us in gross if t_us >= early_us or _at(truth, stuck, t_us) < EARLY_SHARE]
    scores["gross_in_time"] = float(bool(noticed) and noticed[0] <= slip_us + LATE_US)
    if noticed:
        scores["gross_delay_ms"] = (noticed[0] - slip_us) / US_PER_MS
    if truth.slow:
        held = np.flatnonzero(stuck[:first] > HELD_SHARE)
        since_us = int(truth.t_us[held[-1]]) - EARLIER_US if len(held) else int(truth.t_us[0])
        told = [t_us for t_us in incipient if since_us <= t_us <= slip_us]
        scores["lead_20ms"] = float(bool(told) and told[0] <= slip_us - LEAD_US)
    return scores


def _at(truth: Truth, values: Field, t_us: int) -> float:
    return float(values[_row(truth, t_us)])


def _row(truth: Truth, t_us: int) -> int:
    return min(int(np.searchsorted(truth.t_us, t_us)), len(truth.t_us) - 1)


def _false(truth: Truth, stuck: Field, alarms: Sequence[int], after_us: int, share: float) -> float:
    """Return how many alarms were given while more than a share stuck all the while."""
    count = 0
    for t_us in alarms:
        around = slice(_row(truth, t_us - BEFORE_US), _row(truth, t_us + after_us) + 1)
        judged = bool(truth.judged[_row(truth, t_us)])
        count += judged and float(stuck[around].min()) > share
    return float(count)
