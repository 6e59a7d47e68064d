"""What the rows say in sentences, computed from them and from nothing else."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from spikingtac.experiments.cases import ALL, CAMERAS, LOOPS
from spikingtac.experiments.methods import TRUTH
from spikingtac.experiments.rows import Row
from spikingtac.sim.catalog import TRAJECTORIES

OURS = "default"
OWN = ("default", "fast", "paper", TRUTH)
"""Methods that are no baseline."""

TORSION, DRAG, CIRCLES = "finger-torsion", "drag-release", "finger-circles"
"""The trajectories that the paper's observations are about."""

COMPARED = ("error_mean_px", "return_error_mean_px", "return_mean_px", "lost_markers", "id_swaps")
"""Metrics in which a baseline may beat the default; smaller is better in all of them."""


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the sentences of a report's first page."""
    table = {(row.method, row.case, row.metric): row for row in rows}
    return [*_headline(table), *_beaten(table), *_observations(table)]


Rows = dict[tuple[str, str, str], Row]


def _headline(table: Rows) -> Iterator[str]:
    for prefix in CAMERAS:
        case = prefix + ALL
        error, p95 = (
            table.get((OURS, case, "error_mean_px")),
            table.get((OURS, case, "error_p95_px")),
        )
        lost = table.get((OURS, case, "lost_markers"))
        if error and p95 and lost:
            yield (
                f"{OURS} on {case} (simulated, {error.n} trials): {error.value:.3f} px mean, "
                f"{p95.value:.3f} px at the 95th percentile, {lost.value:.0f} markers lost."
            )
    residual, given = (
        table.get((TRUTH, ALL, "return_mean_px")),
        table.get((OURS, ALL, "return_mean_px")),
    )
    if residual and given:
        yield (
            f"Of the return distance of {OURS} on {ALL} ({given.value:.3f} px) the gel itself "
            f"keeps {residual.value:.3f} px: that share is physics and no error."
        )


def _beaten(table: Rows) -> Iterator[str]:
    baselines = sorted({method for method, _, _ in table} - {*OWN})
    cases = list(dict.fromkeys(case for _, case, _ in table))
    any_beaten = False
    for metric in COMPARED:
        for method in baselines:
            won = [
                case
                for case in cases
                if _at(table, method, case, metric) < _at(table, OURS, case, metric)
            ]
            if won:
                any_beaten = True
                yield _defeat(table, method, metric, won)
    if baselines and not any_beaten and (OURS, ALL, "error_mean_px") in table:
        yield f"No baseline beats {OURS} in any case in {', '.join(COMPARED)}."


def _defeat(table: Rows, method: str, metric: str, won: list[str]) -> str:
    first = ALL if ALL in won else won[0]
    text = (
        f"{method} beats {OURS} in {metric} on {', '.join(won)}: {first} "
        f"{_at(table, method, first, metric):.3f} against {_at(table, OURS, first, metric):.3f}"
    )
    way, own_way = (_at(table, who, first, "error_mean_px") for who in (method, OURS))
    if metric.startswith("return") and way > own_way:
        text += f"; on the way it is {way:.3f} px off, {OURS} {own_way:.3f} px"
    return text + "."


def _at(table: Rows, method: str, case: str, metric: str) -> float:
    return _value(table.get((method, case, metric)))


def _value(row: Row | None) -> float:
    return math.nan if row is None or row.value is None else row.value


def _observations(table: Rows) -> Iterator[str]:
    for scene, claim in (
        (TORSION, "Evetac loses boundary markers in large torsion"),
        (DRAG, "Evetac loses lock in drag-and-release"),
    ):
        success = table.get(("evetac", scene, "success_rate"))
        lost = table.get(("evetac", scene, "lost_markers"))
        if success and lost and success.value is not None and lost.value is not None:
            back = "all markers come back" if success.value == 1.0 else "markers do not come back"
            says = "reproduces" if success.value < 1.0 else "does not reproduce as a failed return"
            yield (
                f"The paper's observation '{claim}' {says} here: on {scene} {back} within 5 px in "
                f"{100 * success.value:.0f} % of {success.n} trials, and {lost.value:.0f} markers "
                "are more than 5 px from the truth for over 50 ms on the way."
            )
    yield from _circles(table)
    yield from _neutac(table)
    drift = (
        table.get(("paper", LOOPS, "return_mean_px")),
        table.get((TRUTH, LOOPS, "return_mean_px")),
    )
    if drift[0] and drift[1]:
        yield (
            f"The published law on closed loops ends {drift[0].value:.3f} px from rest, the gel "
            f"itself {drift[1].value:.3f} px (simulated)."
        )


def _circles(table: Rows) -> Iterator[str]:
    methods = ("paper", "evetac", "neutac")
    found = {m: table.get((m, CIRCLES, "return_mean_px")) for m in methods}
    values = {m: row.value for m, row in found.items() if row and row.value is not None}
    if len(values) == len(methods):
        best = min(values, key=lambda method: values[method])
        says = "reproduces" if best == "evetac" else f"does not reproduce: {best} ends nearest"
        told = ", ".join(f"{m} {v:.3f} px" for m, v in values.items())
        yield (
            "The paper's observation 'Evetac has the least drift in localised finger circles' "
            f"{says} ({told}; simulated)."
        )


def _neutac(table: Rows) -> Iterator[str]:
    better = [
        scene
        for scene in TRAJECTORIES
        if (a := table.get(("neutac", scene, "return_mean_px")))
        and (b := table.get(("paper", scene, "return_mean_px")))
        and a.value is not None
        and b.value is not None
        and a.value > b.value
    ]
    if ("neutac", ALL, "return_mean_px") in table and ("paper", ALL, "return_mean_px") in table:
        yield (
            "The paper's observation that NeuTac ends farther from rest than the published law "
            f"holds on {len(better)} of {len(TRAJECTORIES)} trajectories here."
        )
