import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.batch.run_folder import begin_run
from spikingtac.errors import ConfigError
from spikingtac_paper.harness.metric import Metric
from spikingtac_paper.harness.published import POINT_TRACKING
from spikingtac_paper.harness.report import Report, Table
from spikingtac_paper.harness.report_files import latex, write_report
from spikingtac_paper.harness.rows import Row, interval, rows_of
from spikingtac_paper.point_tracking.findings import findings
from spikingtac_paper.point_tracking.tables import report_tables
from spikingtac_paper.trials.laws import LAW
from spikingtac_paper.trials.metrics import POINT_METRICS

METRICS = (
    Metric("return_mean_px", "px", "how far"),
    Metric("lost_markers", "markers", "how many", "sum"),
)


def record(method: str, scene: str, seed: int, far: float, lost: float = 0.0) -> dict:
    trial = {"case": scene, "groups": ["all"], "seed": seed, "source": "twin"}
    return {
        "method": method,
        "trial": trial,
        "scores": {"return_mean_px": far, "lost_markers": lost},
    }


RECORDS = [
    record("evetac", "a", 0, 1.0, 2.0),
    record("evetac", "b", 0, 3.0),
    record("evetac", "a", 1, 2.0, 1.0),
    record("evetac", "b", 1, 4.0),
]


def test_rows_join_trials_and_name_the_papers_number_in_its_case_only() -> None:
    rows = {(r.case, r.metric): r for r in rows_of(RECORDS, METRICS, POINT_TRACKING, "all")}
    assert rows["all", "return_mean_px"].value == 2.5
    assert rows["all", "return_mean_px"].n == 4
    assert rows["all", "return_mean_px"].paper == 1.6276
    assert rows["a", "return_mean_px"].paper is None
    assert rows["all", "lost_markers"].value == 3.0
    low, high = rows["all", "return_mean_px"].ci95 or (0.0, 0.0)
    assert (low + high) / 2 == pytest.approx(2.5)
    # Seeds give 2 and 3: Student's t for one degree of freedom is 12.706, over sqrt(2) * std.
    assert (high - low) / 2 == pytest.approx(12.7062 * np.sqrt(0.5) / np.sqrt(2.0), rel=1e-4)


def test_one_seed_gives_no_interval() -> None:
    assert interval(np.array([1.0])) is None


def report(rows: list[Row]) -> Report:
    table = Table(name="all", title="All <of> it", case="all", metrics=("return_mean_px",),
                  methods=("evetac", "absent"))  # fmt: skip
    return Report(
        experiment="point-tracking",
        title="Point tracking",
        provenance={"command": "spikingtac experiment point-tracking"},
        rows=rows,
        findings=["one & two"],
        tables=[table],
        figures=[("a figure", "<?xml version='1.0'?><svg></svg>")],
    )


def test_report_files(tmp_path: Path) -> None:
    rows = rows_of(RECORDS, METRICS, POINT_TRACKING, "all")
    write_report(report(rows), tmp_path)
    document = json.loads((tmp_path / "report.json").read_text())
    keys = {"method", "case", "metric", "value", "unit", "n", "source", "paper", "definition"}
    assert all(keys <= set(row) for row in document["rows"])
    page = (tmp_path / "report.html").read_text()
    assert "one &amp; two" in page
    assert "All &lt;of&gt; it" in page
    assert "simulated (twin)" in page
    head = page[page.index("<thead>") : page.index("</thead>")]
    columns = ["return_<wbr>mean_<wbr>px<br>paper", "return_<wbr>mean_<wbr>px<br>simulated"]
    assert [head.count(column) for column in columns] == [1, 1], "side by side, never merged"
    assert "1.628" in page
    assert "src=" not in page
    assert "http" not in page
    lines = (tmp_path / "tables" / "rows.csv").read_text().splitlines()
    assert len(lines) == len(rows) + 1
    assert "evetac & 2.500 (1.628)" in (tmp_path / "tables" / "all.tex").read_text()


def test_latex_leaves_out_methods_without_rows() -> None:
    rows = rows_of(RECORDS, METRICS, POINT_TRACKING, "all")
    assert "absent" not in latex(report(rows).tables[0], rows)


def test_single_trajectories_are_folded_and_joined_cases_come_first() -> None:
    cases = ("mixed", "clean/all", "broken-4", "loops", "noisy/all", "all")
    rows = [row("default", case, "error_mean_px", 0.1) for case in cases]
    tables = report_tables(rows, ["default", "default-law-anchored"])
    shown = [table.case for table in tables if not table.folded]
    assert list(dict.fromkeys(shown)) == ["all", "noisy/all", "loops", "clean/all", "broken-4", LAW]
    assert {table.case for table in tables if table.folded} == {"mixed"}


def row(method: str, case: str, metric: str, value: float) -> Row:
    unit = next(m.unit for m in POINT_METRICS if m.name == metric)
    return Row(method=method, case=case, metric=metric, value=value, unit=unit, n=1,
               source="twin", paper=None, definition="")  # fmt: skip


def test_a_baseline_that_wins_is_named() -> None:
    rows = [row("default", "all", "error_mean_px", 0.2), row("evetac", "all", "error_mean_px", 0.1)]
    told = [text for text in findings(rows) if "beats" in text]
    assert told == ["evetac beats default in error_mean_px on all: 0.100 against 0.200."]


def test_a_win_at_rest_says_what_it_cost_on_the_way() -> None:
    rows = [
        row("default", "all", "return_mean_px", 0.2),
        row("evetac", "all", "return_mean_px", 0.1),
        row("default", "all", "error_mean_px", 0.1),
        row("evetac", "all", "error_mean_px", 2.0),
    ]
    told = next(text for text in findings(rows) if "beats" in text)
    assert "on the way it is 2.000 px off, default 0.100 px" in told


def test_a_law_on_the_same_estimates_is_no_baseline() -> None:
    rows = [
        row("default", "all", "return_mean_px", 0.2),
        row("default-law-anchored", "all", "return_mean_px", 0.1),
    ]
    assert not any("beats" in text for text in findings(rows))


def test_many_cases_are_counted_and_few_are_named() -> None:
    cases = ["all", *(f"scene-{n}" for n in range(6))]
    rows = [row("default", case, "error_mean_px", 0.2) for case in cases]
    rows += [row("evetac", case, "error_mean_px", 0.1) for case in cases]
    told = next(text for text in findings(rows) if "beats" in text)
    assert "Also on scene-0, scene-1, scene-2 and 3 other cases." in told


def test_that_none_wins_is_said_only_if_baselines_ran() -> None:
    own = [row("default", "all", "error_mean_px", 0.1)]
    assert not any("No baseline" in text for text in findings(own))
    both = [*own, row("evetac", "all", "error_mean_px", 0.2)]
    assert any("No baseline beats default" in text for text in findings(both))


def test_a_folder_never_mixes_settings(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    begin_run(folder, {"seeds": 1, "methods": ["a"]}, resume=False)
    begin_run(folder, {"seeds": 1, "methods": ["a"]}, resume=True)
    with pytest.raises(ConfigError, match="--resume"):
        begin_run(folder, {"seeds": 1, "methods": ["a"]}, resume=False)
    with pytest.raises(ConfigError, match=r"seeds 1 -> 2.*never mixed"):
        begin_run(folder, {"seeds": 2, "methods": ["a"]}, resume=True)


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("do not touch")
    with pytest.raises(ConfigError, match="not empty"):
        begin_run(tmp_path, {"seeds": 1}, resume=False)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
