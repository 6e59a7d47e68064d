"""From the scores of trials to the rows of a report, with confidence intervals over seeds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac.experiments.harness.metric import Metric
from spikingtac.experiments.harness.published import Published

CONFIDENCE = 0.95
"""Of the intervals."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of ``report.json``.

    Attributes:
        method: Name of the method.
        case: Name of the case.
        metric: Name of the metric.
        value: The figure, or None where nothing could be measured.
        unit: Of the value.
        n: How many trials stand behind it.
        source: ``twin``, ``v2e`` or ``recorded``.
        paper: What the paper prints for it, or None.
        definition: What exactly was measured.
        ci95: Interval of the mean over the seeds, or None where there is one seed only.
        seeds: How many seeds.
    """

    method: str
    case: str
    metric: str
    value: float | None
    unit: str
    n: int
    source: str
    paper: float | None
    definition: str
    ci95: tuple[float, float] | None = None
    seeds: int = 1


def rows_of(
    records: Iterable[Mapping[str, Any]],
    metrics: Sequence[Metric],
    published: Mapping[tuple[str, str], Published],
    paper_case: str,
) -> list[Row]:
    """Join the trials of each method and case.

    Args:
        records: From :func:`~spikingtac.experiments.trials.runner.run_all`.
        metrics: Which scores to report.
        published: (method, metric) -> what the paper prints.
        paper_case: The case that the paper's numbers belong to.
    """
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for record in records:
        trial = record["trial"]
        for case in (trial["case"], *trial["groups"]):
            grouped[case, record["method"]].append(record)
    rows = []
    for (case, method), group in grouped.items():
        for metric in metrics:
            told = [record for record in group if metric.name in record["scores"]]
            if not told:
                continue
            printed = published.get((method, metric.name)) if case == paper_case else None
            rows.append(_row(method, case, metric, told, printed))
    return rows


def _row(
    method: str,
    case: str,
    metric: Metric,
    group: Sequence[Mapping[str, Any]],
    printed: Published | None,
) -> Row:
    values = np.array([record["scores"][metric.name] for record in group])
    seeds = np.array([record["trial"]["seed"] for record in group])
    joined = values.sum() if metric.over_trials == "sum" else values.mean()
    per_seed = np.array([values[seeds == seed].mean() for seed in np.unique(seeds)])
    return Row(
        method=method,
        case=case,
        metric=metric.name,
        value=float(joined),
        unit=metric.unit,
        n=len(values),
        source=str(group[0]["trial"]["source"]),
        paper=printed.value if printed else None,
        definition=metric.definition,
        ci95=interval(per_seed) if metric.over_trials == "mean" else None,
        seeds=len(per_seed),
    )


def interval(values: np.ndarray) -> tuple[float, float] | None:
    """Return Student's interval of the mean, or None for fewer than two values."""
    if len(values) < 2:
        return None
    from scipy.stats import t

    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(values) - 1)) * values.std(ddof=1)
    half /= np.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)
