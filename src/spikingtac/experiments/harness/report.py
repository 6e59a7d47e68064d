"""A run's report: ``report.json``, ``report.html``, ``tables/*.csv`` and ``tables/*.tex``."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from spikingtac.experiments.harness.html_page import page
from spikingtac.experiments.harness.rows import Row
from spikingtac.experiments.harness.run_folder import REPORT, write_json, write_text

COUNTED = ("markers", "approaches")
"""Units of whole numbers."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Which rows to show together: one line per method, one column per metric.

    Attributes:
        name: File name without ending.
        title: Heading.
        case: The case whose rows it shows.
        metrics: Columns.
        methods: Lines, in order.
        folded: Shown on request only: one of many.
    """

    name: str
    title: str
    case: str
    metrics: tuple[str, ...]
    methods: tuple[str, ...]
    folded: bool = False

    @classmethod
    def of_case(
        cls, case: str, metrics: Iterable[str], methods: Iterable[str], *, folded: bool = False
    ) -> Table:
        """Return the table of a case, named after it."""
        return cls(
            name=case.replace("/", "-"),
            title=case,
            case=case,
            metrics=tuple(metrics),
            methods=tuple(methods),
            folded=folded,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """Everything that a run has to say.

    Attributes:
        experiment: Name of the experiment.
        title: Heading of the page.
        provenance: What made it.
        rows: All figures.
        findings: Sentences for the first page.
        tables: Selections of the rows.
        figures: (caption, SVG text) in order.
        methods: Name -> one line about it.
    """

    experiment: str
    title: str
    provenance: dict[str, Any]
    rows: Sequence[Row]
    findings: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[tuple[str, str]] = ()
    methods: Mapping[str, str] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return what ``report.json`` holds."""
        return {
            "experiment": self.experiment,
            "provenance": self.provenance,
            "findings": list(self.findings),
            "rows": [asdict(row) for row in self.rows],
        }

    def write(self, folder: Path) -> None:
        """Write all files of the report into a folder."""
        write_json(folder / REPORT, self.document())
        write_text(folder / "tables" / "rows.csv", _csv(self.rows))
        for table in self.tables:
            write_text(folder / "tables" / f"{table.name}.tex", latex(table, self.rows))
        for number, (_, svg) in enumerate(self.figures, 1):
            write_text(folder / "figures" / f"figure{number}.svg", svg)
        write_text(folder / "report.html", page(self))


def find(rows: Sequence[Row], method: str, case: str, metric: str) -> Row | None:
    """Return the row of a method, case and metric, or None."""
    wanted = (method, case, metric)
    return next((row for row in rows if (row.method, row.case, row.metric) == wanted), None)


def number(value: float | None, unit: str) -> str:
    """Return a figure as it is printed: fractions as percentages, px with three digits."""
    if value is None:
        return "-"
    if unit == "1":
        return f"{100 * value:.4g} %"
    return f"{value:.0f}" if unit in COUNTED else f"{value:.3f}" if value < 100 else f"{value:.1f}"


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
        cells = [find(rows, method, table.case, metric) for metric in table.metrics]
        if any(cells):
            told = [_latex_cell(cell) for cell in cells]
            lines.append(" & ".join([method, *told]) + r" \\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _latex_cell(row: Row | None) -> str:
    if row is None:
        return "--"
    text = number(row.value, row.unit)
    if row.paper is not None:
        text += f" ({number(row.paper, row.unit)})"
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
