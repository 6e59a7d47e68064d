"""From the scores of trials to the rows of a report, with confidence intervals over seeds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac_paper.harness.metric import Metric
from spikingtac_paper.harness.published import Published

CONFIDENCE = 0.95
"""Confidence level of the intervals."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of ``report.json``.

    Attributes:
        method: Name of the method.
        case: Name of the case.
        metric: Name of the metric.
        value: The figure, or None where nothing could be measured.
        unit: Unit of the value.
        n: Number of trials behind it.
        source: ``twin``, ``v2e`` or ``recorded``.
        paper: The number that the paper prints, or None.
        definition: What exactly was measured.
        ci95: 95 % confidence interval of the mean over the seeds; None for a single seed.
        seeds: Number of seeds.
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
    """Return one row for each method, case and metric, over the trials of the case.

    Args:
        records: Scores of the trials, from :func:`~spikingtac_paper.trials.runner.run_all`.
        metrics: Which scores to report.
        published: (method, metric) -> number that the paper prints.
        paper_case: The case to which the paper's numbers belong.
    """
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for record in records:
        trial = record["trial"]
        for case in (trial["case"], *trial["groups"]):
            grouped[case, record["method"]].append(record)
    rows = []
    for (case, method), group in grouped.items():
        for metric in metrics:
            scored = [record for record in group if metric.name in record["scores"]]
            if not scored:
                continue
            printed = published.get((method, metric.name)) if case == paper_case else None
            rows.append(_row(method, case, metric, scored, printed))
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
    total = values.sum() if metric.over_trials == "sum" else values.mean()
    per_seed = np.array([values[seeds == seed].mean() for seed in np.unique(seeds)])
    return Row(
        method=method,
        case=case,
        metric=metric.name,
        value=float(total),
        unit=metric.unit,
        n=len(values),
        source=str(group[0]["trial"]["source"]),
        paper=printed.value if printed else None,
        definition=metric.definition,
        ci95=interval(per_seed) if metric.over_trials == "mean" else None,
        seeds=len(per_seed),
    )


def interval(values: np.ndarray) -> tuple[float, float] | None:
    """Return Student's confidence interval of a mean, or None for fewer than two values."""
    if len(values) < 2:
        return None
    from scipy.stats import t

    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(values) - 1)) * values.std(ddof=1)
    half /= np.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)
