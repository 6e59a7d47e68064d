"""From the records of approaches and free motions to the rows of the collision report."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from spikingtac.contact import DETECTORS
from spikingtac_paper.collision.approach import FRAMES, SECONDS_PER_HOUR
from spikingtac_paper.harness.report import CONFIDENCE, Metric, Row, by_name, interval

Outcome = Mapping[str, float]
ABOUT = {
    "event_count": "as published: events of 1 ms above a threshold, taken from the moving arm",
    "default": "sequential test of the signed rim events over nine time scales",
}

# Name -> one line about it: the contact detectors, then the baselines.
METHODS: dict[str, str] = {name: ABOUT.get(name, "a contact detector") for name in DETECTORS} | {
    "frame_sampling": "displacement sum over the markers at 32 fps, no other latency",
    "frame_plus_one": "the same with one more frame of latency",
    "frame_paper": "135 ms after the touch: the paper's baseline with its undocumented latency",
    "zero_delay": "a perfect sensor: decides at the true first touch, on the same arm",
}
SLOW, FASTEST = "0.0008", "0.18"

# Speeds of the case ``all``, m/s: the paper names the range 0.01 to 0.18.
SPEEDS = ("0.01", "0.02", "0.04", "0.06", "0.08", "0.1", "0.12", "0.14", "0.16", FASTEST)
PRESETS = ("typical", "noisy")
ALL = "all"
METRICS = by_name(
    Metric("deviation_mean_mm", "mm", "true travel of the arm from the first touch to the "
           "decision, mean; event latency and window included, network, cycle and servo not; "
           "`all`: mean over the speeds"),
    Metric("deviation_max_mm", "mm", "the same, worst approach"),
    Metric("deviation_read_mean_mm", "mm", "the same as the controller reports it at the decision: "
           "0 to 8 ms old, repeatability 0.028 mm"),
    Metric("overshoot_mean_mm", "mm", "true travel from the first touch to standstill, mean"),
    Metric("overshoot_max_mm", "mm", "the same, worst approach"),
    Metric("decision_p99_us", "us", "99th percentile of the computing between the end of a window "
           "and the stop command, over all windows that were listened to"),
    Metric("missed", "approaches", "approaches without a decision within the patience"),
    Metric("premature", "approaches", "approaches stopped before the touch; left out of the means"),
    Metric("false_stops_per_hour", "1/h", "false stops per hour of motion with vibration and "
           "without contact, seeds disjoint from the calibration"),
    Metric("false_stops_upper95_per_hour", "1/h", "upper end of the exact two-sided 95 % Poisson "
           "interval (Garwood) of the same"),
    Metric("false_stops_lower95_per_hour", "1/h", "lower end of the same interval"),
    Metric("hours", "h", "length of that motion"),
)  # fmt: skip

# Metric -> the quantity of an outcome whose mean it is.
MEANS = {
    "deviation_mean_mm": "deviation_mm",
    "deviation_read_mean_mm": "read_mm",
    "overshoot_mean_mm": "overshoot_mm",
}

# (method, case, metric) -> number that the paper prints, from its hardware (section V-B).
PRINTED: dict[tuple[str, str, str], float] = {
    ("event_count", f"{PRESETS[0]}/{ALL}", "deviation_mean_mm"): 0.53,
    ("event_count", f"{PRESETS[0]}/{FASTEST}", "overshoot_max_mm"): 6.2,
    ("frame_paper", f"{PRESETS[0]}/{FASTEST}", "deviation_max_mm"): 24.3,
}


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


@dataclass(slots=True)
class Sample:
    """The approaches of one method at one speed.

    Attributes:
        outcomes: Outcome of each approach; None where it was not stopped.
        seeds: Their seeds.
        cost_us: Histogram of the computing time per window, us.
    """

    outcomes: list[Outcome | None] = field(default_factory=list)
    seeds: set[int] = field(default_factory=set)
    cost_us: Counter[int] = field(default_factory=Counter)

    @property
    def decided(self) -> list[Outcome]:
        """The approaches that were stopped."""
        return [outcome for outcome in self.outcomes if outcome is not None]

    def values(self, name: str) -> np.ndarray:
        """Return one quantity ``(n,)`` of every approach that was stopped after the touch."""
        return np.array([one[name] for one in self.decided if one["delay_us"] >= 0.0])


def samples_of(records: Iterable[Mapping[str, Any]]) -> dict[tuple[str, str], Sample]:
    """Group the approaches: (case, method) -> sample."""
    samples: dict[tuple[str, str], Sample] = defaultdict(Sample)
    for record in records:
        for method, outcome in record["methods"].items():
            sample = samples[record["case"], method]
            sample.outcomes.append(outcome)
            sample.seeds.add(record["seed"])
            cost_us = record["costs_us"].get(method, {})
            sample.cost_us.update({int(us): n for us, n in cost_us.items()})
    return samples


def collision_rows(
    approaches: Sequence[Mapping[str, Any]], stretches: Sequence[Mapping[str, Any]]
) -> list[Row]:
    """Return every row of the report.

    Args:
        approaches: Records of the approaches.
        stretches: Records of the motions without contact.
    """
    samples = samples_of(approaches)
    groups = {key: [sample] for key, sample in samples.items()}
    for preset in PRESETS:
        for method in METHODS:
            keys = [(f"{preset}/{speed}", method) for speed in SPEEDS]
            if all(key in samples for key in keys):
                groups[f"{preset}/{ALL}", method] = [samples[key] for key in keys]
    rows = [row for key, parts in groups.items() for row in _approach_rows(*key, parts)]
    rows += _false_stop_rows(stretches)
    rows = [replace(row, paper=PRINTED.get((row.method, row.case, row.metric))) for row in rows]
    # The cases of the first preset have no prefix in other reports: repeated so.
    prefix = f"{PRESETS[0]}/"
    plain = [row for row in rows if row.case.startswith(prefix)]
    return rows + [replace(row, case=row.case.removeprefix(prefix)) for row in plain]


def _approach_rows(case: str, method: str, parts: Sequence[Sample]) -> Iterator[Row]:
    n, seeds = sum(len(one.outcomes) for one in parts), max(len(one.seeds) for one in parts)
    for metric, name in MEANS.items():
        mean, ci95 = _mean([one.values(name) for one in parts])
        yield METRICS[metric].row(method, case, mean, n, ci95=ci95, seeds=seeds)
    decided = sum(len(one.decided) for one in parts)
    deviation, overshoot = (
        np.concatenate([one.values(name) for one in parts])
        for name in ("deviation_mm", "overshoot_mm")
    )
    for metric, value in (
        ("deviation_max_mm", float(deviation.max()) if len(deviation) else None),
        ("overshoot_max_mm", float(overshoot.max()) if len(overshoot) else None),
        ("missed", float(n - decided)),
        ("premature", float(decided - len(deviation))),
    ):
        yield METRICS[metric].row(method, case, value, n, seeds=seeds)
    cost_us: Counter[int] = sum((one.cost_us for one in parts), Counter())
    if cost_us:
        us, times = np.array(sorted(cost_us.items())).T
        rank = np.searchsorted(np.cumsum(times), 0.99 * times.sum())
        yield METRICS["decision_p99_us"].row(method, case, float(us[rank]), int(times.sum()))


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

    variance = sum(part.var(ddof=1) / len(part) for part in parts)
    half = float(norm.isf((1.0 - CONFIDENCE) / 2.0) * np.sqrt(variance)) / len(parts)
    return mean, (mean - half, mean + half)


def _false_stop_rows(stretches: Sequence[Mapping[str, Any]]) -> Iterator[Row]:
    stops: Counter[tuple[str, str]] = Counter()
    hours: dict[str, float] = defaultdict(float)
    for record in stretches:
        hours[record["case"]] += record["seconds"] / SECONDS_PER_HOUR
        for name, found in record["stops"].items():
            stops[record["case"], "frame_sampling" if name == FRAMES else name] += found
    count = Counter(record["case"] for record in stretches)
    for (case, method), found in stops.items():
        low, high = garwood(found, hours[case])
        for metric, value in (
            ("false_stops_per_hour", found / hours[case]),
            ("false_stops_lower95_per_hour", low),
            ("false_stops_upper95_per_hour", high),
            ("hours", hours[case]),
        ):
            yield METRICS[metric].row(method, case, value, count[case], seeds=count[case])
