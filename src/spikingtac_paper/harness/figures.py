"""The figure of a report: a metric over the cases, one line of dots for each method."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np

from spikingtac_paper.harness.report import Row

SALT = "spikingtac"
"""Makes the ids in the SVG the same in every run."""


def dot_figure(
    rows: Sequence[Row], cases: Mapping[str, str], methods: Sequence[str], metric: str
) -> str:
    """Draw a metric over some cases, one line of dots per method, with the seeds' interval; SVG.

    Args:
        rows: Rows of the report.
        cases: The cases in order, each with its label.
        methods: Names of the methods.
        metric: Name of the metric.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    axis = figure.subplots()
    places = np.arange(len(cases))
    for number, method in enumerate(methods):
        found = {row.case: row for row in rows if (row.method, row.metric) == (method, metric)}
        drawn = [found.get(case) for case in cases]
        values = np.array([row.value if row else None for row in drawn], float)
        ends = np.array([(row and row.ci95) or (np.nan, np.nan) for row in drawn])
        spread = np.nan_to_num(np.abs(ends - values[:, None])).T
        shift = 0.5 * (number - (len(methods) - 1) / 2) / len(methods)
        axis.errorbar(places + shift, values, spread, fmt="o", ms=4, lw=1, label=method)
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_xticks(places, list(cases.values()), fontsize=7)
    axis.set_ylabel(metric.replace("_", " "))
    axis.grid(alpha=0.3)
    figure.legend(fontsize=8, ncols=6, loc="outside upper center")
    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": SALT, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
