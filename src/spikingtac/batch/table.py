"""The table of all results: Parquet where pyarrow is installed, CSV otherwise."""

from __future__ import annotations

import csv
import importlib.util
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from spikingtac.atomic_files import replacing
from spikingtac.batch.job import Figure, Outcome

NAME = "results"


def rows_of(
    outcomes: Sequence[Outcome], outliers: Sequence[Mapping[str, float]]
) -> list[dict[str, Figure]]:
    """Return one row for each recording, all with the same columns."""
    names = dict.fromkeys(name for outcome in outcomes for name in outcome.figures)
    return [
        {
            "source": outcome.source,
            "output": None if outcome.failed else outcome.output,
            "status": "failed" if outcome.failed else "done",
            "error": outcome.error,
            "outliers": json.dumps(odd) if odd else None,
            "seconds": round(outcome.seconds, 6),
            **{name: outcome.figures.get(name) for name in names},
        }
        for outcome, odd in zip(outcomes, outliers, strict=True)
    ]


def write_table(folder: Path, rows: Sequence[Mapping[str, Figure]]) -> Path:
    """Write the table into a folder and return its path; one of the other kind is removed."""
    kinds = {".parquet": _write_parquet, ".csv": _write_csv}
    ending = ".parquet" if importlib.util.find_spec("pyarrow") else ".csv"
    path = folder / f"{NAME}{ending}"
    with replacing(path) as partial:
        kinds[ending](partial, rows)
    for other in kinds.keys() - {ending}:
        (folder / f"{NAME}{other}").unlink(missing_ok=True)
    return path


def _write_parquet(path: Path, rows: Sequence[Mapping[str, Figure]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    # A column without any value would have no type, which not every reader knows.
    texts = ("source", "output", "status", "error", "outliers")
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        nothing = all(value is None for value in values)
        kind = pa.string() if name in texts else pa.float64() if nothing else None
        columns[name] = pa.array(values, type=kind)
    pq.write_table(pa.table(columns), path)


def _write_csv(path: Path, rows: Sequence[Mapping[str, Figure]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
