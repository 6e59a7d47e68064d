"""Touches on the twin, from events: found, split, invented, and when."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim import SceneSource, load_scene
from spikingtac.touch import TouchDetector
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.contacts import record, watch

SCENES = ("finger-presses", "finger-slides", "finger-torsion", "spoon-rubs", "comb-slides",
          "spoon-circles", "finger-circles", "drag-release", "finger-rolls", "mixed")  # fmt: skip
QUICK_SCENES = ("finger-slides", "spoon-rubs")
WINDOW_US = 10_000  # Window of the event counts, us.
EVENT_SIGMAS = 6.0  # Deviations above the quiet mean at which a window of events is a touch.
QUIET_WINDOWS = 30  # Windows from the start of a recording that are quiet.
BEGIN_MS, END_MS = 10.0, 100.0  # Errors of begin and end that count as in time, ms.
US_PER_MS = 1e3
METHODS = {
    "touches": "the strain of the field, tracker default",
    "event-threshold": "windows of 10 ms with more events than rest makes",
}
METRICS = (
    Metric("missed", "touches", "true touches without a found one that is theirs alone", "sum"),
    Metric("extra", "touches", "found touches beyond one for each true one", "sum"),
    Metric("begin_in_time", "1", "share of the found ones whose begin errs by 10 ms at most"),
    Metric("end_in_time", "1", "share of the found ones whose end errs by 100 ms at most"),
)

Spans = list[tuple[int, int]]  # Begin and end of touches, us.


def touch_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every scene."""
    records = []
    for name in QUICK_SCENES if quick else SCENES:
        truth, found = _felt(name, seed)
        for method in methods:
            scores = touch_scores(truth, found[method])
            records.append(record(method, (f"touches/{name}", "touches/all"), seed, scores))
    return records


def _felt(name: str, seed: int) -> tuple[Spans, dict[str, Spans]]:
    """Return the true touches of a scene, and those that each method finds."""
    source = SceneSource(load_scene(name), seed)
    detector, last_us, found = TouchDetector(source.reference_px), 0, []
    times_us: list[int] = []
    pressed: list[bool] = []
    windows: list[NDArray[np.int64]] = []

    def note(step: Any) -> None:
        times_us.extend(step.truth.contact_t_us.tolist())
        pressed.extend(step.truth.in_contact.tolist())
        windows.append(step.packet.t // WINDOW_US)

    for frame in watch(source, note):
        last_us = frame.t_us
        touch = detector.update(frame)
        if touch is not None:
            found.append((touch.begin_us, touch.end_us or last_us))
    open_touch = detector.finish()
    if open_touch is not None:
        found.append((open_touch.begin_us, last_us))
    truth = [(times_us[a], times_us[min(b, len(times_us) - 1)]) for a, b in _runs(pressed)]
    by_events = event_touches(np.bincount(np.concatenate(windows)))
    return truth, {"touches": found, "event-threshold": by_events}


def _runs(flags: Any) -> Spans:
    """Return first and last-but-one index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.array([False, *flags, False], np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def event_touches(counts: NDArray[np.int64]) -> Spans:
    """Return begin and end, us, of the stretches in which events exceed their quiet rate.

    Args:
        counts: ``(n,)`` events in each window of :data:`WINDOW_US`; the first are quiet.
    """
    quiet = counts[:QUIET_WINDOWS]
    threshold = float(quiet.mean()) + EVENT_SIGMAS * max(float(quiet.std()), 1.0)
    return [(a * WINDOW_US, b * WINDOW_US) for a, b in _runs(counts > threshold)]


def touch_scores(truth: Spans, found: Spans) -> dict[str, float]:
    """Compare found touches with true ones, both as begin and end in us, each with one other."""
    pairs = _pairs(truth, found)
    scores = {"missed": float(len(truth) - len(pairs)), "extra": float(len(found) - len(pairs))}
    if pairs:
        errors_us = np.array([np.subtract(found[one], truth[true]) for true, one in pairs])
        begin_ms, end_ms = np.abs(errors_us).T / US_PER_MS
        scores["begin_in_time"] = float((begin_ms <= BEGIN_MS).mean())
        scores["end_in_time"] = float((end_ms <= END_MS).mean())
    return scores


def _pairs(truth: Spans, found: Spans) -> list[tuple[int, int]]:
    """Return which true touch is which found one, by number: as many as can be, longest overlaps.

    A found touch that spans two true ones is one of them; the other is missed.
    """
    # A late import: every verb's start would wait for it.
    from scipy.optimize import linear_sum_assignment

    true, told = (np.array(rows, np.int64).reshape(-1, 2) for rows in (truth, found))
    begin_us = np.maximum(true[:, None, 0], told[None, :, 0])
    overlap_us = np.maximum(np.minimum(true[:, None, 1], told[None, :, 1]) - begin_us, 0)
    worth = overlap_us + (overlap_us > 0) * int(overlap_us.sum())
    rows, columns = linear_sum_assignment(worth, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(row, column) for row, column in pairs if overlap_us[row, column] > 0]
