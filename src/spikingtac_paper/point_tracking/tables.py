"""The tables of the point-tracking experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spikingtac_paper.harness.report import Table
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.point_tracking.cases import ALL, CAMERAS, DAMAGES, FIFTY, LOOPS
from spikingtac_paper.trials.laws import LAW, LAW_MARK, LAW_METRICS
from spikingtac_paper.trials.trials import V2E

PAPER_COLUMNS = (
    "success_rate",
    "return_mean_px",
    "return_std_px",
    "zeroed_return_mean_px",
    "zeroed_return_std_px",
)
TRUTH_COLUMNS = (
    "error_mean_px",
    "error_p95_px",
    "error_final_px",
    "return_error_mean_px",
    "return_growth_px",
    "lead_px",
    "lost_markers",
    "id_swaps",
)
LAW_COLUMNS = ("success_rate", "return_mean_px", "return_std_px")
LAW_CASES = (LOOPS, FIFTY, ALL)
"""Cases in which output laws are compared."""

FIRST = (*(prefix + ALL for prefix in CAMERAS), f"{V2E}/mix", LOOPS, FIFTY)
"""Cases of the first tables. Other cases of several trials follow; single trials are folded."""

BROKEN = tuple(f"broken-{count}" for count in DAMAGES)


def report_tables(rows: Sequence[Row], names: Sequence[str]) -> list[Table]:
    """Return the tables of a report: for each case the paper's metrics and those against the truth.

    Args:
        rows: Rows of the report.
        names: Names of the methods, in order.
    """
    laws = tuple(name for name in names if LAW_MARK in name)
    trackers = tuple(name for name in names if name not in laws)
    seen = list(dict.fromkeys(row.case for row in rows if row.case != LAW))
    joined = [case for case in seen if case.endswith(ALL) or case in BROKEN]
    first = [case for case in dict.fromkeys((*FIRST, *joined)) if case in seen]
    rest = [case for case in seen if case not in first]
    return [
        *(one for case in first for one in _both(case, trackers)),
        *(_laws(case, laws, names) for case in LAW_CASES if laws and case in seen),
        *([_exact(laws)] if laws else []),
        *(replace(one, folded=True) for case in rest for one in _both(case, trackers)),
    ]


def _both(case: str, methods: tuple[str, ...]) -> list[Table]:
    stem = case.replace("/", "-")
    return [
        Table(
            name=f"{stem}-{kind}",
            title=f"{case}: {about}",
            case=case,
            metrics=columns,
            methods=methods,
        )
        for kind, about, columns in (
            ("paper", "the paper's metrics", PAPER_COLUMNS),
            ("truth", "against the truth", TRUTH_COLUMNS),
        )
    ]


def _laws(case: str, laws: tuple[str, ...], names: Sequence[str]) -> Table:
    beside = tuple(name for name in ("default", "paper", "truth") if name in names)
    return Table(
        name=f"{case}-laws",
        title=f"{case}: output laws on the same estimates",
        case=case,
        metrics=LAW_COLUMNS,
        methods=(*beside, *laws),
    )


def _exact(laws: tuple[str, ...]) -> Table:
    return Table(
        name="law-bounds",
        title="What each law does to exact detections",
        case=LAW,
        metrics=tuple(LAW_METRICS),
        methods=laws,
    )
