"""From scores to rows, and from rows to ``report.json``, a page and a table."""

from __future__ import annotations

import io
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from typing import Any, Literal

import numpy as np

from spikingtac.atomic_files import write_json, write_text
from spikingtac.batch import write_rows
from spikingtac_paper.harness.run import RunOptions, provenance

CONFIDENCE = 0.95  # Confidence level of the intervals.
REPORT = "report.json"
COUNTED = ("markers", "approaches")  # Units of whole numbers.
COLUMNS = ("method", "case", "metric", "value", "unit", "n", "seeds", "ci95", "source", "paper")

# Source of a row -> what the page calls it; these are never merged.
SOURCES = {"twin": "simulated (twin)", "v2e": "simulated (v2e)", "recorded": "recorded"}
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid #d8dee4;text-align:right;white-space:nowrap}
th{vertical-align:bottom}th:first-child,td:first-child{text-align:left}
.grey{color:#57606a;font-size:.85em}.paper{color:#8250df}.scroll{overflow-x:auto}
figure{margin:1rem 0}svg{max-width:100%;height:auto}
summary{font-size:1.2rem;font-weight:600;margin-top:2rem;cursor:pointer}
pre{background:#f6f8fa;padding:.8rem;overflow-x:auto}
"""


@dataclass(frozen=True, slots=True)
class Metric:
    """A number that each trial yields.

    Attributes:
        name: As in ``report.json``; the unit is in the name.
        unit: ``px``, ``markers`` or ``1`` (a fraction).
        definition: What exactly is measured.
        over_trials: How the values of the trials of a case are combined.
    """

    name: str
    unit: str
    definition: str
    over_trials: Literal["mean", "sum"] = "mean"

    def row(self, method: str, case: str, value: float | None, n: int, **more: Any) -> Row:
        """Return a row of the report: a value over ``n`` trials, with further attributes."""
        about = {"metric": self.name, "unit": self.unit, "definition": self.definition}
        return Row(method=method, case=case, value=value, n=n, **about, **more)


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
    source: str = "twin"
    paper: float | None = None
    definition: str
    ci95: tuple[float, float] | None = None
    seeds: int = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """The whole report of a run.

    Attributes:
        title: Heading of the page.
        settings: The settings of the run, with its name under ``experiment`` or ``bench``.
        rows: All results.
        about: What else belongs to the provenance.
        first: Cases whose tables the page shows; it folds the others.
        findings: Lines for the first page and the terminal.
        figures: (caption, SVG text) in order.
        methods: Name -> one line about it.
    """

    title: str
    settings: Mapping[str, Any]
    rows: Sequence[Row]
    about: Mapping[str, Any] = field(default_factory=dict)
    first: Sequence[str] = ()
    findings: Sequence[str] = ()
    figures: Sequence[tuple[str, str]] = ()
    methods: Mapping[str, str] = field(default_factory=dict)


def rows_of(
    records: Iterable[Mapping[str, Any]],
    metrics: Sequence[Metric],
    published: Mapping[tuple[str, str], float] | None = None,
    paper_case: str = "",
) -> list[Row]:
    """Return one row for each method, case and metric, over the trials of the case.

    Args:
        records: Scores of the trials: ``method``, ``trial`` and ``scores`` each.
        metrics: Which scores to report.
        published: (method, metric) -> number that the paper prints.
        paper_case: The case to which the paper's numbers belong.
    """
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for record in records:
        for case in (record["trial"]["case"], *record["trial"]["groups"]):
            grouped[case, record["method"]].append(record)
    printed = published or {}
    return [
        _row(method, case, metric, scored, printed if case == paper_case else {})
        for (case, method), group in grouped.items()
        for metric in metrics
        if (scored := [record for record in group if metric.name in record["scores"]])
    ]


def _row(
    method: str,
    case: str,
    metric: Metric,
    group: Sequence[Mapping[str, Any]],
    printed: Mapping[tuple[str, str], float],
) -> Row:
    values = np.array([record["scores"][metric.name] for record in group])
    seeds = np.array([record["trial"]["seed"] for record in group])
    per_seed = np.array([values[seeds == seed].mean() for seed in np.unique(seeds)])
    about = {"source": str(group[0]["trial"]["source"]), "seeds": len(per_seed)}
    about["paper"] = printed.get((method, metric.name))
    if metric.over_trials == "sum":
        return metric.row(method, case, float(values.sum()), len(values), **about)
    ci95 = interval(per_seed)
    return metric.row(method, case, float(values.mean()), len(values), ci95=ci95, **about)


def by_name(*metrics: Metric) -> dict[str, Metric]:
    """Return metrics by their names, in order."""
    return {metric.name: metric for metric in metrics}


def interval(values: np.ndarray) -> tuple[float, float] | None:
    """Return Student's confidence interval of a mean, or None for fewer than two values."""
    if len(values) < 2:
        return None
    from scipy.stats import t

    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(values) - 1)) * values.std(ddof=1)
    half /= np.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)


def lines_of(rows: Sequence[Row], cases: Iterable[str], methods: Sequence[str]) -> list[str]:
    """Return a line for each of some cases and methods: every figure that it has."""
    lines = []
    for case in cases:
        for method in methods:
            here = [row for row in rows if (row.method, row.case) == (method, case)]
            texts = [
                f"{row.metric} {row.value:.3g}" + (f" (paper {row.paper:g})" if row.paper else "")
                for row in here
                if row.value is not None
            ]
            if texts:
                source = SOURCES.get(here[0].source, here[0].source)
                lines.append(f"{case}, {method}, {source}: {', '.join(texts)}.")
    return lines


def write_report(report: Report, options: RunOptions, **counts: int) -> dict[str, Any]:
    """Write all files of a report into the folder of the run; return the summary of the run.

    Args:
        report: What was found.
        options: The options of the run.
        **counts: What else was counted, as ``trials``.
    """
    folder, findings = options.output, list(report.findings)
    rows, about = [asdict(row) for row in report.rows], provenance(options, report.settings)
    about |= report.about
    name = report.settings.get("experiment") or report.settings["bench"]
    document = {"experiment": name, "provenance": about, "findings": findings}
    write_json(folder / REPORT, document | {"rows": rows})
    lines = [
        {name: row[name] for name in COLUMNS}
        | {"ci95": " to ".join(f"{end:.6g}" for end in row["ci95"] or ())}
        for row in rows
    ]
    write_rows(folder / "tables" / "rows.csv", COLUMNS, lines)
    for number, (_, svg) in enumerate(report.figures, 1):
        write_text(folder / "figures" / f"figure{number}.svg", svg)
    write_text(folder / "report.html", html_page(report, about))
    summary = {"experiment": name, "output": str(folder), **counts}
    return summary | {"rows": len(rows), "findings": findings}


def html_page(report: Report, about: Mapping[str, Any]) -> str:
    """Return the report as one self-contained page: no script, no link to anywhere."""
    cases = list(dict.fromkeys(row.case for row in report.rows))
    tables = {
        case: _table(case, [row for row in report.rows if row.case == case]) for case in cases
    }
    shown = [case for case in report.first if case in tables] or cases
    folded = "".join(tables[case] for case in cases if case not in shown)
    definitions = {row.metric: row.definition for row in report.rows}
    parts = [
        f"<h1>{escape(report.title)}</h1>",
        f"<p>Made by <code>{escape(str(about.get('command')))}</code>, version "
        f"{escape(str(about.get('package_version')))}, commit "
        f"{escape(str(about.get('git_commit')))}. What is simulated, recorded and printed by the "
        "paper (violet, its own hardware) is never merged. In grey: 95 % interval of the mean over "
        "the seeds, where there is more than one.</p>",
        _listed("What came out", dict.fromkeys(report.findings, "")),
        *(tables[case] for case in shown),
        *(
            f"<figure>{svg[svg.find('<svg') :]}<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, svg in report.figures
        ),
        f"<details><summary>Every other case</summary>{folded}</details>" if folded else "",
        _listed("Methods", report.methods),
        _listed("Metrics", definitions),
        f"<h2>Provenance</h2><pre>{escape(json.dumps(about, indent=1, sort_keys=True))}</pre>",
    ]
    head = f"<meta charset='utf-8'><title>{escape(report.title)}</title><style>{STYLE}</style>"
    body = "".join(parts)
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{body}</body></html>\n"


def _listed(title: str, items: Mapping[str, str]) -> str:
    lines = [f"<li><b>{escape(key)}</b> {escape(text)}</li>" for key, text in items.items()]
    return f"<h2>{title}</h2><ul>{''.join(lines)}</ul>" if lines else ""


def _table(case: str, rows: Sequence[Row]) -> str:
    metrics = list(dict.fromkeys(row.metric for row in rows))
    found = {(row.method, row.metric): row for row in rows}
    head = "".join(f"<th>{escape(name).replace('_', '_<wbr>')}</th>" for name in metrics)
    lines = [
        f"<tr><td>{escape(method)}</td>"
        + "".join(_cell(found.get((method, metric))) for metric in metrics)
        + "</tr>"
        for method in dict.fromkeys(row.method for row in rows)
    ]
    source = SOURCES.get(rows[0].source, rows[0].source)
    trials, seeds = max(row.n for row in rows), max(row.seeds for row in rows)
    return (
        f"<h2>{escape(case)}</h2><p class='grey'><b>{source}</b>, n = {trials}, seeds: {seeds}</p>"
        f"<div class='scroll'><table><thead><tr><th>method</th>{head}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _cell(row: Row | None) -> str:
    if row is None:
        return "<td>-</td>"
    text = figure_text(row.value, row.unit)
    if row.paper is not None:
        text += f" <span class='paper'>{figure_text(row.paper, row.unit)}</span>"
    if row.ci95 is not None:
        low, high = (figure_text(end, row.unit) for end in row.ci95)
        text += f"<br><span class='grey'>{low} to {high}</span>"
    return f"<td>{text}</td>"


def figure_text(value: float | None, unit: str) -> str:
    """Return a figure as it is printed: fractions as percentages, others with three digits."""
    if value is None:
        return "-"
    if unit == "1":
        return f"{100 * value:.4g} %"
    return f"{value:.0f}" if unit in COUNTED else f"{value:.3f}" if value < 100 else f"{value:.1f}"


SALT = "spikingtac"  # Makes the ids in the SVG the same in every run.


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
