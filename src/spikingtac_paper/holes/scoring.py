"""From the touches of the hole experiment to estimates, errors and rows of the report."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikingtac.geometry import Circle, TravelModel
from spikingtac.robot import Touched, hole_around
from spikingtac.sim import (
    CORNER_MM,
    CROSS,
    DEFAULT,
    SIGMAS_MM,
    HoleTrial,
    hole_trial,
    touched_of,
    travel_of,
)
from spikingtac.types import FloatArray
from spikingtac_paper.harness.report import Metric, Row, by_name, interval
from spikingtac_paper.holes.cross_search import calibrated_circle, published_circle

# Ten radii from 0.7 to 5.0 mm, the range of section V-C.
RADII_MM: tuple[float, ...] = tuple(round(0.7 + 4.3 / 9 * k, 3) for k in range(10))
PITCH_MM = 15.0  # Distance of neighbouring holes, mm (the holes do not touch each other).
COLUMNS = 5  # Holes in a row of the plate; it has two rows.
MOST_CONTACTS = 12  # Contacts of the adaptive search.
CROSS_CONTACTS = 4

# 95 % quantile of chi-squared with three degrees of freedom: centre and radius together.
REGION = 7.8147

# Error beyond which an estimate counts as diverged, mm: five times the paper's RMSE.
DIVERGED_MM = 0.5


# (method, metric) over all ten holes -> number of the paper's table 'Quantitative results of
# position and radius deviation'. Its abstract calls the signed mean an RMSE; the RMSE here
# follows from the ten printed errors.
PUBLISHED: dict[tuple[str, str], float] = {
    ("cross4-published", "position_rmse_kabsch_mm"): 0.0952,
    ("cross4-published", "radius_rmse_mm"): 0.0780,
    ("cross4-published", "radius_mean_signed_mm"): 0.0452,
}


@dataclass(frozen=True, slots=True)
class HoleMethod:
    """A way to estimate a hole from stored touches.

    Attributes:
        style: The search that made the touches: ``cross`` or ``default``.
        contacts: Number of contacts that are used.
        about: One line for the report.
    """

    style: str
    contacts: int
    about: str


# Name -> method.
METHODS: dict[str, HoleMethod] = {
    "cross4-published": HoleMethod(
        CROSS, CROSS_CONTACTS, "the paper's search at 0.8 mm/s with its constants, R_offset "
        "0.375 mm and delta_crit 0.4 mm; it states no uncertainty, coverage95 uses that of four "
        "even contacts"),
    "cross4": HoleMethod(
        CROSS, CROSS_CONTACTS, "the same touches and formulas with delta_crit calibrated by "
        "direction and the hexagon's mean reach"),
    "default-4": HoleMethod(DEFAULT, 4, "the adaptive search, its first 4 contacts"),
    "default-12": HoleMethod(DEFAULT, MOST_CONTACTS, "the adaptive search with 12 contacts"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class HoleScore:
    """One estimate against the truth.

    Attributes:
        seed: Seed of the plate.
        hole: Index of the hole.
        circle: The estimate, or None where the search ended with an error.
        center_mm: ``(2,)`` true centre, mm.
        radius_mm: True radius, mm.
        sigma_mm: Standard deviation of a contact according to the calibration, mm.
        presses: Number of touches of the wall, conditioning included.
        contacts: Number of readings that the estimate uses.
    """

    seed: int
    hole: int
    circle: Circle | None
    center_mm: FloatArray
    radius_mm: float
    sigma_mm: float
    presses: int
    contacts: int

    @property
    def error_mm(self) -> FloatArray:
        """Errors ``(3,)`` of centre x, centre y and radius, mm; infinite without an estimate."""
        if self.circle is None:
            return np.full(3, np.inf)
        away = self.circle.center_mm - self.center_mm
        return np.append(away, self.circle.radius_mm - self.radius_mm)

    @property
    def diverged(self) -> bool:
        """Whether there is no estimate, or one with an error above :data:`DIVERGED_MM`."""
        return bool(np.abs(self.error_mm).max() > DIVERGED_MM)

    @property
    def covered(self) -> bool:
        """Whether the stated 95 % region contains the truth."""
        if self.circle is None:
            return False
        error = self.error_mm
        return bool(error @ np.linalg.solve(self.circle.covariance_mm2, error) < REGION)


def trial_of(seed: int, hole: int) -> HoleTrial:
    """Return a hole of a seed's plate, with the start of its search."""
    center = PITCH_MM * np.array([hole % COLUMNS, hole // COLUMNS], np.float64)
    return hole_trial(RADII_MM[hole], center, CORNER_MM, seed)


def score(
    method: str, record: Mapping[str, Any], calibration: Mapping[str, Any], sigma_mm: float
) -> HoleScore:
    """Estimate one hole by one method, for an arm of some repeatability.

    Args:
        method: Name in :data:`METHODS`.
        record: From :func:`~spikingtac_paper.holes.experiment.run_searches`.
        calibration: From :func:`~spikingtac_paper.holes.experiment.run_calibration`.
        sigma_mm: Repeatability per axis and reading, mm.
    """
    rule = METHODS[method]
    trial = trial_of(record["seed"], record["hole"])
    travel = travel_of(calibration[rule.style], sigma_mm)
    stored, used = record[rule.style]["touches"], record[rule.style]["used"][: rule.contacts]
    made = stored[: used[-1] + 1] if used else stored
    touches = [touched_of(stored[number], sigma_mm) for number in used]
    found = len(touches) == rule.contacts
    return HoleScore(
        seed=record["seed"],
        hole=record["hole"],
        circle=_estimate(method, touches, travel) if found else None,
        center_mm=trial.center_mm,
        radius_mm=trial.wall.radius_mm,
        sigma_mm=travel.sigma_mm,
        presses=sum(one["presses"] for one in made),
        contacts=rule.contacts,
    )


def _estimate(method: str, touches: list[Touched], travel: TravelModel) -> Circle:
    if method == "cross4-published":
        return published_circle(touches, travel.sigma_mm)
    if method == "cross4":
        return calibrated_circle(touches, travel)
    return hole_around(touches, travel)


def hole_rows(
    records: Sequence[Mapping[str, Any]],
    calibrations: Mapping[int, Mapping[str, Any]],
    methods: Sequence[str],
) -> list[Row]:
    """Return all rows: every method, repeatability and hole, and all holes together."""
    rows: list[Row] = []
    for prefix, sigma_mm in SIGMAS_MM.items():
        for method in methods:
            scores = [score(method, one, calibrations[one["seed"]], sigma_mm) for one in records]
            holes = sorted({one.hole for one in scores})
            for hole in holes:
                part = [one for one in scores if one.hole == hole]
                rows += _rows(method, f"{prefix}/hole-{hole + 1}", part)
            rows += _rows(method, f"{prefix}/all", scores)
    return rows


METRICS = by_name(
    Metric("position_rmse_mm", "mm", "root mean square distance of estimated and true centre, "
           "robot frame"),
    Metric("position_rmse_kabsch_mm", "mm", "the same after each plate's estimated centres were "
           "laid onto the true ones by rotation and translation (Kabsch), as in the paper"),
    Metric("radius_rmse_mm", "mm", "root mean square error of the radius"),
    Metric("radius_mean_signed_mm", "mm", "signed mean error of the radius (the paper's 0.0452 mm, "
           "which its abstract calls RMSE)"),
    Metric("coverage95", "1", "fraction of trials whose stated 95 % region of centre and radius "
           "contains the truth"),
    Metric("bound_ratio", "times", "position RMSE over 2 sigma_c / sqrt(contacts), sigma_c being "
           "the standard deviation of a contact on the calibration's flat wall"),
    Metric("contacts", "count", "number of readings that an estimate uses"),
    Metric("touches", "count", "number of presses against the wall for them, finding and "
           "conditioning included"),
    Metric("diverged", "count", "trials without an estimate, or off by more than 0.5 mm in any "
           "coordinate; they are left out of the other figures"),
)  # fmt: skip


def _rows(method: str, case: str, scores: Sequence[HoleScore]) -> list[Row]:
    good = [one for one in scores if not one.diverged]
    values: dict[str, float | None] = dict.fromkeys(METRICS)
    values["diverged"] = float(len(scores) - len(good))
    values["contacts"] = float(METHODS[method].contacts)
    spans: dict[str, tuple[float, float] | None] = {}
    if good:
        values |= _figures(good)
        seeds = sorted({one.seed for one in good})
        each = [_figures([one for one in good if one.seed == seed]) for seed in seeds]
        spans = {name: interval(np.array([one[name] for one in each])) for name in each[0]}
        if (ends := spans["coverage95"]) is not None:
            spans["coverage95"] = max(ends[0], 0.0), min(ends[1], 1.0)
    if not case.endswith("/all"):
        del values["position_rmse_kabsch_mm"]
    printed = PUBLISHED if case == "rep028/all" else {}
    return [
        METRICS[name].row(
            method,
            case,
            value,
            len(scores if name == "diverged" else good),
            paper=printed.get((method, name)),
            ci95=spans.get(name),
            seeds=len({one.seed for one in scores}),
        )
        for name, value in values.items()
    ]


def _figures(scores: Sequence[HoleScore]) -> dict[str, float]:
    error = np.array([one.error_mm for one in scores])
    position = _rms(np.linalg.norm(error[:, :2], axis=1))
    sigma = _rms(np.array([one.sigma_mm for one in scores]))
    return {
        "position_rmse_mm": position,
        "position_rmse_kabsch_mm": _rms(_aligned(scores)),
        "radius_rmse_mm": _rms(error[:, 2]),
        "radius_mean_signed_mm": float(error[:, 2].mean()),
        "coverage95": float(np.mean([one.covered for one in scores])),
        "bound_ratio": position / (2.0 * sigma / math.sqrt(scores[0].contacts)),
        "touches": float(np.mean([one.presses for one in scores])),
    }


def _aligned(scores: Sequence[HoleScore]) -> FloatArray:
    """Return the distances ``(n,)`` after the alignment of each plate, mm."""
    left = []
    for seed in {one.seed for one in scores}:
        plate = [(one.circle, one.center_mm) for one in scores if one.seed == seed]
        found = np.array([circle.center_mm for circle, _ in plate if circle is not None])
        true = np.array([center for _, center in plate])
        left.append(np.linalg.norm(laid_onto(found, true) - true, axis=1))
    return np.concatenate(left)


def laid_onto(points: FloatArray, onto: FloatArray) -> FloatArray:
    """Return points ``(n, 2)`` after the rigid motion that brings them nearest to others (Kabsch).

    The rotation is proper: a mirrored set is not reached by a reflection.

    Source: Kabsch, doi:10.1107/S0567739476001873; sign handling as Umeyama, doi:10.1109/34.88573.
    """
    middle, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (onto - goal))
    sign = np.diag([1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    return (points - middle) @ (vt.T @ sign @ u.T).T + goal


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
