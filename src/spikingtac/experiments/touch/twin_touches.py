"""Touches on the twin, from events: found, split, invented, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.config import load_config
from spikingtac.experiments.harness.metric import Metric
from spikingtac.experiments.touch.baselines import event_touches
from spikingtac.experiments.touch.true_calibration import true_calibration
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.source import SceneSource
from spikingtac.touch.touches.detector import TouchDetector
from spikingtac.types import EventPacket

SCENES = ("finger-presses", "finger-slides", "finger-torsion", "spoon-rubs", "comb-slides",
          "spoon-circles", "finger-circles", "drag-release", "finger-rolls", "mixed")  # fmt: skip
QUICK_SCENES = ("finger-slides", "spoon-rubs")
WINDOW_US = 10_000
"""Window of the event counts, us."""
BEGIN_MS, END_MS = 10.0, 100.0
"""Errors of begin and end that count as in time, ms."""
METHODS = {
    "touches": "the strain of the field, tracker default",
    "event-threshold": "windows of 10 ms with more events than rest makes",
}
METRICS = (
    Metric("missed", "touches", "true touches that no found touch overlaps", "sum"),
    Metric("extra", "touches", "found touches beyond one for each true one", "sum"),
    Metric("begin_in_time", "1", "share of the touches whose begin errs by 10 ms at most"),
    Metric("end_in_time", "1", "share of the touches whose end errs by 100 ms at most"),
)


class _Watched:
    """A scene's events, with what is needed of its truth kept on the way."""

    def __init__(self, name: str, seed: int) -> None:
        self.source = SceneSource(catalog.load(name), seed)
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


def touch_records(methods: list[str], seeds: range, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every scene."""
    records = []
    for name in QUICK_SCENES if quick else SCENES:
        for seed in seeds:
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
    """Compare found touches with true ones, both as begin and end in us."""
    begins, ends, missed, used = [], [], 0, 0
    for begin_us, end_us in truth:
        over = [one for one in found if one[0] < end_us and one[1] > begin_us]
        if not over:
            missed += 1
            continue
        used += 1
        begins.append(abs(over[0][0] - begin_us) <= BEGIN_MS * 1e3)
        ends.append(abs(over[-1][1] - end_us) <= END_MS * 1e3)
    scores = {"missed": float(missed), "extra": float(len(found) - used)}
    if begins:
        scores |= {"begin_in_time": float(np.mean(begins)), "end_in_time": float(np.mean(ends))}
    return scores
