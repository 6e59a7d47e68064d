"""Touches on the twin, from events: found, split, invented, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac import follow, make_tracker
from spikingtac.config import load_config
from spikingtac.sim import SceneSource, load_scene
from spikingtac.touch import TouchDetector
from spikingtac.types import EventPacket
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.baselines import event_touches
from spikingtac_paper.touch.true_calibration import true_calibration

SCENES = ("finger-presses", "finger-slides", "finger-torsion", "spoon-rubs", "comb-slides",
          "spoon-circles", "finger-circles", "drag-release", "finger-rolls", "mixed")  # fmt: skip
QUICK_SCENES = ("finger-slides", "spoon-rubs")
WINDOW_US = 10_000
"""Window of the event counts, us."""
BEGIN_MS, END_MS = 10.0, 100.0
"""Errors of begin and end that count as in time, ms."""
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


class _Watched:
    """A scene's events, with what is needed of its truth kept on the way."""

    def __init__(self, name: str, seed: int) -> None:
        self.source = SceneSource(load_scene(name), seed)
        self.size = self.source.size
        self.contact: list[tuple[int, bool]] = []
        self.counts: list[NDArray[np.int64]] = []

    def __iter__(self) -> Iterator[EventPacket]:
        for step in self.source.steps():
            pressed = step.truth.in_contact.tolist()
            self.contact += zip(step.truth.contact_t_us.tolist(), pressed, strict=True)
            self.counts.append(step.packet.t // WINDOW_US)
            yield step.packet

    def true_touches(self) -> list[tuple[int, int]]:
        """Return begin and end of every contact, us."""
        times = np.array([t_us for t_us, _ in self.contact])
        pressed = np.concatenate([[False], [on for _, on in self.contact], [False]])
        edges = np.flatnonzero(np.diff(pressed.astype(np.int8))).reshape(-1, 2)
        return [(int(times[a]), int(times[min(b, len(times) - 1)])) for a, b in edges]


def touch_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every scene."""
    records = []
    for name in QUICK_SCENES if quick else SCENES:
        watched = _Watched(name, seed)
        found = {"touches": _felt(watched)}
        windows = np.bincount(np.concatenate(watched.counts))
        found["event-threshold"] = event_touches(windows, WINDOW_US)
        truth = watched.true_touches()
        for method in methods:
            trial = {"case": f"touches/{name}", "groups": ["touches/all"], "seed": seed,
                     "source": "twin"}  # fmt: skip
            scores = touch_scores(truth, found[method])
            records.append({"method": method, "trial": trial, "scores": scores})
    return records


def _felt(watched: _Watched) -> list[tuple[int, int]]:
    source, config = watched.source, load_config("default").tracking
    detector, last_us, out = TouchDetector(source.reference_px), 0, []
    for frame in follow(watched, make_tracker(config, true_calibration(source)), config.rate_hz):
        last_us = frame.t_us
        touch = detector.update(frame)
        if touch is not None:
            out.append((touch.begin_us, touch.end_us or last_us))
    open_touch = detector.finish()
    return out if open_touch is None else [*out, (open_touch.begin_us, last_us)]


def touch_scores(truth: list[tuple[int, int]], found: list[tuple[int, int]]) -> dict[str, float]:
    """Compare found touches with true ones, both as begin and end in us, each with one other."""
    pairs = _pairs(truth, found)
    scores = {"missed": float(len(truth) - len(pairs)), "extra": float(len(found) - len(pairs))}
    if pairs:
        errors_us = np.array([np.subtract(found[one], truth[true]) for true, one in pairs])
        begin_ms, end_ms = np.abs(errors_us).T / US_PER_MS
        scores["begin_in_time"] = float((begin_ms <= BEGIN_MS).mean())
        scores["end_in_time"] = float((end_ms <= END_MS).mean())
    return scores


def _pairs(truth: list[tuple[int, int]], found: list[tuple[int, int]]) -> list[tuple[int, int]]:
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
