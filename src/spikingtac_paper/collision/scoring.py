"""From the records of approaches and free motions to the rows of the collision report."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikingtac_paper.collision.approach import FRAMES
from spikingtac_paper.collision.jobs import METHODS
from spikingtac_paper.harness.report import CONFIDENCE, Row, interval

Outcome = Mapping[str, float]
SECONDS_PER_HOUR = 3600.0
SLOW, FASTEST = "0.0008", "0.18"
SPEEDS = ("0.01", "0.02", "0.04", "0.06", "0.08", "0.1", "0.12", "0.14", "0.16", FASTEST)
"""Speeds of the case ``all``, m/s: the paper names the range 0.01 to 0.18."""
PRESETS = ("typical", "noisy")
ALL = "all"

DEFINITIONS: dict[str, tuple[str, str]] = {
    "deviation_mean_mm": (
        "mm",
        "true travel of the arm from the first touch to the decision, mean; event latency and "
        "window included, network, cycle and servo not; `all`: mean over the speeds",
    ),
    "deviation_max_mm": ("mm", "the same, worst approach"),
    "deviation_read_mean_mm": (
        "mm",
        "the same as the controller reports it at the decision: 0 to 8 ms old, repeatability "
        "0.028 mm",
    ),
    "overshoot_mean_mm": ("mm", "true travel from the first touch to standstill, mean"),
    "overshoot_max_mm": ("mm", "the same, worst approach"),
    "decision_p99_us": (
        "us",
        "99th percentile of the computing between the end of a window and the stop command, over "
        "all windows that were listened to",
    ),
    "missed": ("approaches", "approaches without a decision within the patience"),
    "premature": ("approaches", "approaches stopped before the touch; left out of the means"),
    "false_stops_per_hour": (
        "1/h",
        "false stops per hour of motion with vibration and without contact, seeds disjoint from "
        "the calibration",
    ),
    "false_stops_upper95_per_hour": (
        "1/h",
        "upper end of the exact two-sided 95 % Poisson interval (Garwood) of the same",
    ),
    "false_stops_lower95_per_hour": ("1/h", "lower end of the same interval"),
    "hours": ("h", "length of that motion"),
}
"""Metric -> unit, and what exactly is measured."""

PRINTED: dict[tuple[str, str, str], float] = {
    ("event_count", f"{PRESETS[0]}/{ALL}", "deviation_mean_mm"): 0.53,
    ("event_count", f"{PRESETS[0]}/{FASTEST}", "overshoot_max_mm"): 6.2,
    ("frame_paper", f"{PRESETS[0]}/{FASTEST}", "deviation_max_mm"): 24.3,
}
"""(method, case, metric) -> number that the paper prints, from its hardware (section V-B)."""


def garwood(events: int, hours: float) -> tuple[float, float]:
    """Return the exact two-sided 95 % interval of a Poisson rate, per hour.

    Garwood 1936, doi:10.1093/biomet/28.3-4.437.

    Args:
        events: Number of events.
        hours: Time in which they were counted, h.
    """
    from scipy.stats import chi2

    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(chi2.ppf(tail, 2 * events)) / 2.0 if events else 0.0
    return low / hours, float(chi2.isf(tail, 2 * events + 2)) / 2.0 / hours


@dataclass(frozen=True, slots=True)
class Sample:
    """The approaches of one method at one speed.

    Attributes:
        found: Outcomes of the approaches that were stopped after the touch.
        missed: Number of approaches that were not stopped.
        premature: Number of approaches that were stopped before the touch.
        seeds: Number of seeds.
    """

    found: tuple[Outcome, ...]
    missed: int
    premature: int
    seeds: int

    @property
    def approaches(self) -> int:
        """Number of approaches."""
        return len(self.found) + self.missed + self.premature

    def values(self, name: str) -> np.ndarray:
        """Return one quantity of every outcome, ``(n,)``."""
        return np.array([outcome[name] for outcome in self.found])


def samples_of(records: Iterable[Mapping[str, Any]]) -> dict[tuple[str, str], Sample]:
    """Group the approaches: (case, method) -> sample."""
    grouped: dict[tuple[str, str], list[tuple[int, Outcome | None]]] = defaultdict(list)
    for record in records:
        for method, outcome in record["methods"].items():
            grouped[record["case"], method].append((record["seed"], outcome))
    out = {}
    for key, pairs in grouped.items():
        decided = [outcome for _, outcome in pairs if outcome is not None]
        found = tuple(outcome for outcome in decided if outcome["delay_us"] >= 0.0)
        out[key] = Sample(
            found=found,
            missed=len(pairs) - len(decided),
            premature=len(decided) - len(found),
            seeds=len({seed for seed, _ in pairs}),
        )
    return out


def collision_rows(
    approaches: Sequence[Mapping[str, Any]], stretches: Sequence[Mapping[str, Any]]
) -> list[Row]:
    """Return every row of the report.

    Args:
        approaches: Records of the approaches.
        stretches: Records of the motions without contact.
    """
    samples = samples_of(approaches)
    costs = _costs(approaches)
    rows = []
    for (case, method), sample in samples.items():
        rows += _approach_rows(case, method, {case: sample})
        rows += _cost_rows(case, method, [costs.get((case, method), Counter())])
    for preset in PRESETS:
        case = f"{preset}/{ALL}"
        for method in METHODS:
            parts = {f"{preset}/{speed}": samples.get((f"{preset}/{speed}", method))
                     for speed in SPEEDS}  # fmt: skip
            known = {name: part for name, part in parts.items() if part is not None}
            if len(known) == len(SPEEDS):
                rows += _approach_rows(case, method, known)
                rows += _cost_rows(case, method, [costs.get((one, method), Counter())
                                                  for one in known])  # fmt: skip
    rows += _false_stop_rows(stretches)
    rows = [replace(row, paper=PRINTED.get((row.method, row.case, row.metric))) for row in rows]
    return rows + list(_unprefixed(rows))


def _approach_rows(case: str, method: str, parts: Mapping[str, Sample]) -> Iterator[Row]:
    samples = list(parts.values())
    n, seeds = sum(one.approaches for one in samples), max(one.seeds for one in samples)

    def row(metric: str, value: float | None, ci95: tuple[float, float] | None = None) -> Row:
        unit, definition = DEFINITIONS[metric]
        return Row(
            method=method, case=case, metric=metric, value=value, unit=unit, n=n,
            definition=definition, ci95=ci95, seeds=seeds,
        )  # fmt: skip

    for metric, name in (
        ("deviation_mean_mm", "deviation_mm"),
        ("deviation_read_mean_mm", "read_mm"),
        ("overshoot_mean_mm", "overshoot_mm"),
    ):
        yield row(metric, *_mean([one.values(name) for one in samples]))
    for metric, name in (
        ("deviation_max_mm", "deviation_mm"),
        ("overshoot_max_mm", "overshoot_mm"),
    ):
        yield row(metric, _over_all([one.values(name) for one in samples], np.max))
    yield row("missed", float(sum(one.missed for one in samples)))
    yield row("premature", float(sum(one.premature for one in samples)))


def _mean(parts: Sequence[np.ndarray]) -> tuple[float | None, tuple[float, float] | None]:
    """Return the mean over the speeds of the means over approaches, with its interval."""
    if not all(len(part) for part in parts):
        return None, None
    mean = float(np.mean([part.mean() for part in parts]))
    if len(parts) == 1:
        return mean, interval(parts[0])
    if any(len(part) < 2 for part in parts):
        return mean, None
    from scipy.stats import norm

    half = float(norm.isf((1.0 - CONFIDENCE) / 2.0)) / len(parts)
    half *= float(np.sqrt(sum(part.var(ddof=1) / len(part) for part in parts)))
    return mean, (mean - half, mean + half)


def _over_all(parts: Sequence[np.ndarray], join: Callable[[np.ndarray], Any]) -> float | None:
    whole = np.concatenate(parts)
    return float(join(whole)) if len(whole) else None


def _costs(approaches: Iterable[Mapping[str, Any]]) -> dict[tuple[str, str], Counter[int]]:
    out: dict[tuple[str, str], Counter[int]] = defaultdict(Counter)
    for record in approaches:
        for method, cost in record["costs_us"].items():
            out[record["case"], method].update({int(us): n for us, n in cost.items()})
    return out


def _cost_rows(case: str, method: str, costs: Sequence[Counter[int]]) -> Iterator[Row]:
    total: Counter[int] = sum(costs, Counter())
    if not total:
        return
    us, times = np.array(sorted(total.items())).T
    rank = np.searchsorted(np.cumsum(times), 0.99 * times.sum())
    unit, definition = DEFINITIONS["decision_p99_us"]
    yield Row(
        method=method, case=case, metric="decision_p99_us", value=float(us[rank]), unit=unit,
        n=int(times.sum()), definition=definition,
    )  # fmt: skip


def _false_stop_rows(stretches: Iterable[Mapping[str, Any]]) -> Iterator[Row]:
    stops: dict[tuple[str, str], int] = defaultdict(int)
    hours: dict[str, float] = defaultdict(float)
    count: Counter[str] = Counter()
    for record in stretches:
        hours[record["case"]] += record["seconds"] / SECONDS_PER_HOUR
        count[record["case"]] += 1
        for name, found in record["stops"].items():
            stops[record["case"], "frame_sampling" if name == FRAMES else name] += found
    for (case, method), found in stops.items():
        low, high = garwood(found, hours[case])
        for metric, value in (
            ("false_stops_per_hour", found / hours[case]),
            ("false_stops_lower95_per_hour", low),
            ("false_stops_upper95_per_hour", high),
            ("hours", hours[case]),
        ):
            unit, definition = DEFINITIONS[metric]
            yield Row(
                method=method, case=case, metric=metric, value=value, unit=unit, n=count[case],
                definition=definition, seeds=count[case],
            )  # fmt: skip


def _unprefixed(rows: Iterable[Row]) -> Iterator[Row]:
    """Repeat the rows of the first preset under cases without a prefix, as in other reports."""
    prefix = f"{PRESETS[0]}/"
    for row in rows:
        if row.case.startswith(prefix):
            yield replace(row, case=row.case.removeprefix(prefix))
