"""The findings of the point-tracking report: sentences that are computed from its rows alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from spikingtac.sim.scene.catalog import TRAJECTORIES
from spikingtac_paper.harness.rows import Row
from spikingtac_paper.point_tracking.cases import ALL, CAMERAS, FIFTY, LOOPS
from spikingtac_paper.trials.laws import LAW, LAW_MARK
from spikingtac_paper.trials.methods import TRUTH

OURS = "default"
OWN = ("default", "fast", TRUTH)
"""Methods that are not baselines; the published pipeline is a baseline."""

TORSION, DRAG, CIRCLES = "finger-torsion", "drag-release", "finger-circles"
"""The trajectories of the paper's observations."""

ANCHORED = f"{OURS}{LAW_MARK}anchored"
NAMED_CASES = 3
"""Number of further cases that a sentence names."""

LEAD_PX = 0.05
"""Smallest mean lead that counts as a bias, px (ours: half of the best trackers' error)."""

COMPARED = ("error_mean_px", "return_error_mean_px", "return_mean_px", "lost_markers", "id_swaps")
"""Metrics in which a baseline may beat the default; smaller is better in all of them."""


def findings(rows: Sequence[Row]) -> list[str]:
    """Return the sentences of a report's first page."""
    table = {(row.method, row.case, row.metric): row for row in rows}
    return [*_headline(table), *_beaten(table), *_laws(table), *_observations(table)]


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
            f"keeps {residual.value:.3f} px: this part is physics and no error."
        )


def _beaten(table: Rows) -> Iterator[str]:
    methods = {method for method, _, _ in table} - {*OWN}
    baselines = sorted(method for method in methods if LAW_MARK not in method)
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
    first = next((prefix + ALL for prefix in CAMERAS if prefix + ALL in won), won[0])
    others = [case for case in won if case != first]
    text = (
        f"{method} beats {OURS} in {metric} on {first}: {_at(table, method, first, metric):.3f} "
        f"against {_at(table, OURS, first, metric):.3f}"
    )
    way, own_way = (_at(table, who, first, "error_mean_px") for who in (method, OURS))
    if metric.startswith("return") and way > own_way:
        text += f"; on the way it is {way:.3f} px off, {OURS} {own_way:.3f} px"
    if others:
        names = ", ".join(others[:NAMED_CASES])
        more = len(others) - NAMED_CASES
        text += f". Also on {names}" + (f" and {more} other cases" if more > 0 else "")
    return text + "."


def _laws(table: Rows) -> Iterator[str]:
    slope = table.get((ANCHORED, LAW, "steepest_slope"))
    falsified = table.get((ANCHORED, LAW, "worst_falsification_px"))
    mean, spread = (table.get((OURS, ALL, f"zeroed_return_{kind}_px")) for kind in ("mean", "std"))
    if mean and spread and slope and falsified:
        yield (
            f"Zeroed by the anchored law, {OURS} returns on {ALL} to {mean.value:.3f} px of rest, "
            f"standard deviation {spread.value:.3f} px (simulated), at a steepest slope of "
            f"{slope.value:.2f} and a worst falsification of {falsified.value:.2f} px."
        )
    growth = table.get((OURS, FIFTY, "return_growth_px"))
    if growth:
        yield (
            f"Over {FIFTY} the error of {OURS} against the truth changes by {growth.value:+.3f} px "
            "from the first return to the last (simulated)."
        )
    drift = (
        table.get(("paper", LOOPS, "return_mean_px")),
        table.get((f"{OURS}{LAW_MARK}paper", LOOPS, "return_mean_px")),
        table.get((TRUTH, LOOPS, "return_mean_px")),
    )
    if drift[0] and drift[2]:
        same = f", on the estimates of {OURS} {drift[1].value:.3f} px" if drift[1] else ""
        yield (
            f"The published law ends closed loops {drift[0].value:.3f} px from rest{same}; the gel "
            f"itself keeps {drift[2].value:.3f} px (simulated)."
        )


def _at(table: Rows, method: str, case: str, metric: str) -> float:
    return _value(table.get((method, case, metric)))


def _value(row: Row | None) -> float:
    return math.nan if row is None or row.value is None else row.value


def _observations(table: Rows) -> Iterator[str]:
    for scene, observation in (
        (TORSION, "Evetac loses boundary markers in large torsion"),
        (DRAG, "Evetac loses lock in drag-and-release"),
    ):
        success = table.get(("evetac", scene, "success_rate"))
        lost = table.get(("evetac", scene, "lost_markers"))
        rim = table.get(("evetac", scene, "lost_boundary_markers"))
        if not (success and lost and rim):
            continue
        says = "reproduces" if _value(success) < 1.0 else "does not reproduce as a failed return"
        on_rim = f", {rim.value:.0f} of them on the rim" if scene == TORSION else ""
        yield (
            f"The paper's observation '{observation}' {says} here: on {scene} all markers end "
            f"within 5 px of rest in {100 * _value(success):.0f} % of {success.n} trials; "
            f"{lost.value:.0f} markers{on_rim} are more than 5 px from the truth for over 50 ms on "
            "the way."
        )
    yield from _circles(table)
    yield from _neutac(table)


def _circles(table: Rows) -> Iterator[str]:
    methods = ("paper", "evetac", "neutac")
    found = {m: table.get((m, CIRCLES, "return_mean_px")) for m in methods}
    values = {m: row.value for m, row in found.items() if row and row.value is not None}
    if len(values) == len(methods):
        best = min(values, key=lambda method: values[method])
        says = "reproduces" if best == "evetac" else f"does not reproduce: {best} ends nearest"
        values_text = ", ".join(f"{m} {v:.3f} px" for m, v in values.items())
        yield (
            "The paper's observation 'Evetac has the least drift in localised finger circles' "
            f"{says} ({values_text}; simulated)."
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
    leads = {m: _at(table, m, ALL, "lead_px") for m in ("neutac", "paper", OURS)}
    if not any(math.isnan(lead) for lead in leads.values()):
        says = "reproduces" if leads["neutac"] > LEAD_PX else "does not reproduce"
        leads_text = ", ".join(f"{method} {lead:+.3f} px" for method, lead in leads.items())
        yield (
            f"The paper's observation of NeuTac's bias in the direction of motion {says}: mean "
            f"error along the true motion on {ALL} {leads_text} (simulated; before any law)."
        )
