"""The report as one self-contained HTML page: no script, no link to anywhere."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

from spikingtac_paper.harness.report import Report, Table, figure_text, find_row
from spikingtac_paper.harness.rows import Row

SOURCES = {"twin": "simulated (twin)", "v2e": "simulated (v2e)", "recorded": "recorded"}
"""Source of a row -> what the page calls it; these columns are never merged."""

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.2rem}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid #d8dee4;text-align:right}
td{white-space:nowrap}th{vertical-align:bottom}
th:first-child,td:first-child{text-align:left}thead th{border-bottom:2px solid #57606a}
.ci,.def{color:#57606a;font-size:.85em}.def{max-width:60rem}
.paper{color:#8250df}.scroll{overflow-x:auto}figure{margin:1rem 0}svg{max-width:100%;height:auto}
summary{font-size:1.2rem;font-weight:600;margin-top:2rem;cursor:pointer}
pre{background:#f6f8fa;padding:.8rem;overflow-x:auto}
"""


def html_page(report: Report) -> str:
    """Return the whole page."""
    parts = [
        f"<h1>{escape(report.title)}</h1>",
        f"<p>Made by <code>{escape(str(report.provenance.get('command')))}</code>, version "
        f"{escape(str(report.provenance.get('package_version')))}, commit "
        f"{escape(str(report.provenance.get('git_commit')))}. Columns: what the paper prints (its "
        "own hardware), what was simulated, what was recorded; they are never merged. In grey: "
        "95 % interval of the mean over the seeds, where there is more than one.</p>",
        _findings(report.findings),
        *(_table(table, report.rows) for table in report.tables if not table.folded),
        *(
            f"<figure>{svg[svg.find('<svg') :]}<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, svg in report.figures
        ),
        _folded([_table(table, report.rows) for table in report.tables if table.folded]),
        _methods(report.methods),
        _definitions(report.rows),
        "<h2>Provenance</h2><pre>" + escape(_indented(report.provenance)) + "</pre>",
    ]
    head = f"<meta charset='utf-8'><title>{escape(report.title)}</title><style>{STYLE}</style>"
    return (
        f"<!doctype html><html lang='en'><head>{head}</head><body>{''.join(parts)}</body></html>\n"
    )


def _folded(tables: Sequence[str]) -> str:
    if not any(tables):
        return ""
    return f"<details><summary>Every other case on its own</summary>{''.join(tables)}</details>"


def _findings(findings: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in findings)
    return f"<h2>What came out</h2><ul>{items}</ul>" if items else ""


def _table(table: Table, rows: Sequence[Row]) -> str:
    shown = {
        (method, metric): find_row(rows, method, table.case, metric)
        for method in table.methods
        for metric in table.metrics
    }
    found = [row for row in shown.values() if row is not None]
    if not found:
        return ""
    source = SOURCES.get(found[0].source, found[0].source)
    printed = [m for m in table.metrics if any(r.paper is not None for r in found if r.metric == m)]
    head = ["<th>method</th>"]
    for metric in table.metrics:
        name = _heading(metric, next((row.unit for row in found if row.metric == metric), "1"))
        beside = ("<br>paper", "<br>simulated") if metric in printed else ("", "")
        head += [f"<th class='paper'>{name}{beside[0]}</th>"] if metric in printed else []
        head.append(f"<th>{name}{beside[1]}</th>")
    lines = []
    for method in table.methods:
        cells = [shown[method, metric] for metric in table.metrics]
        if any(cells):
            line = "".join(
                _cell(cell, metric in printed)
                for cell, metric in zip(cells, table.metrics, strict=True)
            )
            lines.append(f"<tr><td>{escape(method)}</td>{line}</tr>")
    violet = "; violet: what the paper prints, on its own hardware" if printed else ""
    return (
        f"<h2>{escape(table.title)}</h2>"
        f"<p class='def'><b>{source}</b>, {_count(found)}{violet}</p>"
        f"<div class='scroll'><table><thead><tr>{''.join(head)}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _heading(metric: str, unit: str) -> str:
    named = unit == "1" or metric.endswith(unit)
    return escape(metric).replace("_", "_<wbr>") + ("" if named else f", {escape(unit)}")


def _count(rows: Sequence[Row]) -> str:
    trials, seeds = max(row.n for row in rows), max(row.seeds for row in rows)
    plural = "" if trials == 1 else "s", "" if seeds == 1 else "s"
    return f"n = {trials} trial{plural[0]}, {seeds} seed{plural[1]}"


def _cell(row: Row | None, with_paper: bool) -> str:
    paper = ""
    if with_paper:
        text = figure_text(row.paper, row.unit) if row is not None and row.paper is not None else ""
        paper = f"<td class='paper'>{text}</td>"
    if row is None:
        return f"{paper}<td>-</td>"
    ends = ""
    if row.ci95 is not None:
        low, high = (figure_text(end, row.unit) for end in row.ci95)
        ends = f"<br><span class='ci'>{low} to {high}</span>"
    return f"{paper}<td>{figure_text(row.value, row.unit)}{ends}</td>"


def _methods(methods: Any) -> str:
    items = "".join(f"<li><b>{escape(k)}</b>: {escape(v)}</li>" for k, v in methods.items())
    return f"<h2>Methods</h2><ul>{items}</ul>" if items else ""


def _definitions(rows: Sequence[Row]) -> str:
    known = {row.metric: row.definition for row in rows}
    items = "".join(f"<li><b>{escape(k)}</b>: {escape(v)}</li>" for k, v in known.items())
    return f"<h2>Metrics</h2><ul class='def'>{items}</ul>"


def _indented(document: Any) -> str:
    return json.dumps(document, indent=1, sort_keys=True)
