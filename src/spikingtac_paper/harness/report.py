"""What a report holds: rows, tables, figures and findings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from spikingtac_paper.harness.rows import Row

COUNTED = ("markers", "approaches")
"""Units of whole numbers."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """A table of the report: one line per method, one column per metric.

    Attributes:
        name: File name without ending.
        title: Heading.
        case: The case whose rows it shows.
        metrics: Names of the columns.
        methods: Names of the lines, in order.
        folded: Whether the page hides it until a click.
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
    """The whole report of a run.

    Attributes:
        experiment: Name of the experiment.
        title: Heading of the page.
        provenance: How it was made, from ``fingerprint.provenance``.
        rows: All results.
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


def find_row(rows: Sequence[Row], method: str, case: str, metric: str) -> Row | None:
    """Return the row of a method, case and metric, or None."""
    key = (method, case, metric)
    return next((row for row in rows if (row.method, row.case, row.metric) == key), None)


def figure_text(value: float | None, unit: str) -> str:
    """Return a figure as it is printed: fractions as percentages, others with three digits."""
    if value is None:
        return "-"
    if unit == "1":
        return f"{100 * value:.4g} %"
    return f"{value:.0f}" if unit in COUNTED else f"{value:.3f}" if value < 100 else f"{value:.1f}"
