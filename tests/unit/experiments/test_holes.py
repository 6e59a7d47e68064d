"""Scores and rows of the hole experiment, from touches of an ideal prober."""

from typing import Any

import numpy as np
import pytest

from spikingtac.geometry.travel import hexagon_reach_mm
from spikingtac.robot.adaptive_search import probe_hole
from spikingtac.robot.prober import Touched
from spikingtac.sim.rig.hole_site import ANGLES_DEG, CROSS, DEFAULT, STYLES, WALL_MM, travel_of
from spikingtac_paper.harness.report import Row
from spikingtac_paper.holes.cross_search import cross_search
from spikingtac_paper.holes.scoring import (
    METHODS,
    METRICS,
    RADII_MM,
    hole_rows,
    laid_onto,
    score,
    trial_of,
)
from stand_ins.touching import IdealProber

HEADING_RAD, TRAVEL_MM = 0.3, 0.12


def row_of(rows: list[Row], *key: str) -> Row:
    (found,) = [row for row in rows if (row.method, row.case, row.metric) == key]
    return found


def kept(touched: Touched, rng: np.random.Generator) -> dict[str, Any]:
    names = "start_mm", "direction", "reading_mm"
    record = {name: getattr(touched, name).tolist() for name in names}
    return record | {"draw": rng.standard_normal(2).tolist(), "presses": 2}


def calibration(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 1])
    record: dict[str, Any] = {"seed": seed}
    for style in STYLES:
        angle = np.radians(np.tile(ANGLES_DEG[style], 3))
        unit = np.column_stack([np.cos(angle), np.sin(angle)])
        beyond = WALL_MM + TRAVEL_MM - hexagon_reach_mm(0.75, angle - HEADING_RAD)
        touches = [Touched(np.zeros(2), one, b * one) for one, b in zip(unit, beyond, strict=True)]
        record[style] = [kept(touch, rng) for touch in touches]
    return record


def record(seed: int, hole: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 2, hole])
    trial = trial_of(seed, hole)
    x, y = trial.center_mm
    prober = IdealProber(RADII_MM[hole], (x, y), HEADING_RAD, TRAVEL_MM)
    travel = travel_of(calibration(seed)[DEFAULT], 0.008)
    found: dict[str, Any] = {"seed": seed, "hole": hole}
    for style, made in (
        (CROSS, cross_search(prober, trial.start_mm, travel)),
        (DEFAULT, probe_hole(prober, travel, trial.start_mm).touches),
    ):
        told = [kept(touch, rng) for touch in made]
        found[style] = {"touches": told, "used": list(range(len(made))), "error": None}
    return found


@pytest.fixture(scope="module")
def plates() -> tuple[list[dict[str, Any]], dict[int, dict[str, Any]]]:
    seeds = (0, 1)
    records = [record(seed, hole) for seed in seeds for hole in range(len(RADII_MM))]
    return records, {seed: calibration(seed) for seed in seeds}


def test_every_method_case_and_metric_has_its_row(plates: Any) -> None:
    rows = hole_rows(*plates, list(METHODS))
    for prefix in ("rep028", "rep008"):
        for method in METHODS:
            for metric in METRICS:
                row_of(rows, method, f"{prefix}/all", metric)
            row_of(rows, method, f"{prefix}/hole-10", "radius_rmse_mm")
    assert row_of(rows, "cross4-published", "rep028/all", "radius_rmse_mm").paper == 0.0780


def test_repeatability_alone_gives_the_bound(plates: Any) -> None:
    """An ideal prober's contacts err by the arm only: 2 sigma / sqrt(n), and honest regions."""
    rows = hole_rows(*plates, ["default-4", "default-12"])
    for prefix, sigma_mm in (("rep028", 0.028), ("rep008", 0.008)):
        for method, contacts in (("default-4", 4), ("default-12", 12)):
            error_mm = row_of(rows, method, f"{prefix}/all", "position_rmse_mm").value
            assert error_mm == pytest.approx(2.0 * sigma_mm / np.sqrt(contacts), rel=0.35)
            assert (row_of(rows, method, f"{prefix}/all", "coverage95").value or 0.0) >= 0.85


def test_a_search_that_ended_with_an_error_counts_as_diverged(plates: Any) -> None:
    records, calibrations = plates
    failed = {**records[0], CROSS: {"touches": [], "used": [], "error": "no wall"}}
    found = score("cross4", failed, calibrations[0], 0.028)
    assert found.diverged
    assert not found.covered
    rows = hole_rows([failed, *records[1:]], calibrations, ["cross4"])
    row = row_of(rows, "cross4", "rep028/all", "diverged")
    assert (row.value, row.n) == (1.0, len(records))


def test_a_plate_is_laid_onto_the_truth_by_a_proper_motion() -> None:
    points, angle, shift = np.random.default_rng(1).normal(size=(10, 2)), 2.5, np.array([3.0, -1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = points @ turn.T + shift
    np.testing.assert_allclose(laid_onto(points, moved), moved, atol=1e-9)
    np.testing.assert_allclose(laid_onto(points[:1], moved[:1]), moved[:1])
    mirrored = moved * [-1.0, 1.0]
    assert np.abs(laid_onto(points, mirrored) - mirrored).max() > 0.1
