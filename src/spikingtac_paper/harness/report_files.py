"""The files of a report: ``report.json``, ``report.html``, ``tables/*.csv``, ``tables/*.tex``."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import write_json, write_text
from spikingtac_paper.harness.html_page import html_page
from spikingtac_paper.harness.report import Report, Table, figure_text, find_row
from spikingtac_paper.harness.rows import Row

REPORT = "report.json"


def write_report(report: Report, folder: Path, **counts: int) -> dict[str, Any]:
    """Write all files of a report into a folder; return the summary of the run.

    Args:
        report: What was found.
        folder: Where to write.
        **counts: What else was counted, as ``trials``.
    """
    write_json(folder / REPORT, report.document())
    write_text(folder / "tables" / "rows.csv", _csv(report.rows))
    for table in report.tables:
        write_text(folder / "tables" / f"{table.name}.tex", latex(table, report.rows))
    for number, (_, svg) in enumerate(report.figures, 1):
        write_text(folder / "figures" / f"figure{number}.svg", svg)
    write_text(folder / "report.html", html_page(report))
    return {
        "experiment": report.experiment,
        "output": str(folder),
        **counts,
        "rows": len(report.rows),
        "findings": list(report.findings),
    }


def latex(table: Table, rows: Sequence[Row]) -> str:
    """Return a table as LaTeX, the paper's number in brackets where it prints one."""
    columns = [name.replace("_", r"\_") for name in table.metrics]
    lines = [
        rf"% {table.title} (simulated or recorded as the column 'source' of rows.csv says)",
        rf"\begin{{tabular}}{{l{'r' * len(columns)}}}",
        r"\hline",
        " & ".join(["method", *columns]) + r" \\",
        r"\hline",
    ]
    for method in table.methods:
        cells = [find_row(rows, method, table.case, metric) for metric in table.metrics]
        if any(cells):
            texts = [_latex_cell(cell) for cell in cells]
            lines.append(" & ".join([method, *texts]) + r" \\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _latex_cell(row: Row | None) -> str:
    if row is None:
        return "--"
    text = figure_text(row.value, row.unit)
    if row.paper is not None:
        text += f" ({figure_text(row.paper, row.unit)})"
    return text.replace("%", r"\%")


def _csv(rows: Sequence[Row]) -> str:
    out = io.StringIO(newline="")
    columns = ("method", "case", "metric", "value", "unit", "n", "seeds", "ci95", "source", "paper")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = asdict(row)
        values["ci95"] = " to ".join(f"{end:.6g}" for end in row.ci95) if row.ci95 else ""
        writer.writerow(["" if values[name] is None else values[name] for name in columns])
    return out.getvalue()
