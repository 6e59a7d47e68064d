"""The report on many recordings: one page, failures and outliers first; no script, no link."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from spikingtac.atomic_files import write_text
from spikingtac.batch.job import Figure
from spikingtac.batch.outliers import LIMIT

REPORT = "report.html"
LARGEST_TABLE = 2_000
"""Rows of the page; the rest is in the table of all results."""
SHOWN_NOT = ("output", "status", "error", "outliers")
"""Columns that the page tells in its first one, or not at all."""

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:80rem;padding:0 1rem}
h1{font-size:1.6rem}table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid #d8dee4;text-align:right}
th:first-child,td:first-child,.why{text-align:left}thead th{border-bottom:2px solid #57606a}
.failed td{background:#ffebe9}.odd td{background:#fff8c5}.scroll{overflow-x:auto}
td.odd{font-weight:700}.note{color:#57606a}
"""


def ordered(rows: Sequence[Mapping[str, Figure]]) -> list[Mapping[str, Figure]]:
    """Return the rows: failures first, then outliers by their largest score, then the others."""
    return sorted(rows, key=lambda row: (row["status"] != "failed", -_largest(row)))


def write_report(folder: Path, title: str, rows: Sequence[Mapping[str, Figure]]) -> Path:
    """Write the page into a folder and return its path.

    Args:
        folder: Where it is written.
        title: What was done with the recordings.
        rows: From :func:`spikingtac.batch.table.rows_of`.
    """
    names = [name for name in rows[0] if name not in SHOWN_NOT]
    body = "".join(_line(row, names) for row in ordered(rows)[:LARGEST_TABLE])
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    failed = sum(row["status"] == "failed" for row in rows)
    odd = sum(row["outliers"] is not None for row in rows)
    text = (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
        f"<h1>{escape(title)}</h1><p>{len(rows)} recordings, {failed} failed, {odd} unlike the "
        f"others.</p><p class='note'>Unlike the others: a figure whose modified z-score (Iglewicz "
        f"and Hoaglin 1993) is above {LIMIT}; it is bold. The table beside this page holds every "
        "row.</p><div class='scroll'><table><thead><tr>"
        f"{head}<th class='why'>why it is here</th></tr></thead><tbody>{body}</tbody></table></div>"
        "</body></html>\n"
    )
    path = folder / REPORT
    write_text(path, text)
    return path


def reason(row: Mapping[str, Figure]) -> str:
    """Return why a row stands first, or an empty text."""
    if row["status"] == "failed":
        return str(row["error"])
    return ", ".join(f"{name} (z {score:g})" for name, score in _scores(row).items())


def _line(row: Mapping[str, Figure], names: Sequence[str]) -> str:
    odd = _scores(row)
    kind = "failed" if row["status"] == "failed" else "odd" if odd else ""
    cells = "".join(
        f"<td class='odd'>{_cell(row[name])}</td>"
        if name in odd
        else f"<td>{_cell(row[name])}</td>"
        for name in names
    )
    return f"<tr class='{kind}'>{cells}<td class='why'>{escape(reason(row))}</td></tr>"


def _cell(value: Figure) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else escape(str(value))


def _scores(row: Mapping[str, Figure]) -> dict[str, float]:
    return json.loads(str(row["outliers"])) if row["outliers"] is not None else {}


def _largest(row: Mapping[str, Figure]) -> float:
    return max(_scores(row).values(), default=0.0)
