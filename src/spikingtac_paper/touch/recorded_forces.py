"""Forces of a real gel: each series predicted from the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch import WrenchSeries, fit_force, load_series, network_trainer, r_squared
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.baselines import MeanDisplacement

Field = NDArray[np.float64]

FOLDER = "force"
FORCES = ("fx", "fy", "fz")
METHODS = {
    "network": "the force network (needs torch), in-plane displacements only",
    "ridge": "the ridge regression on the field's shape, in-plane displacements only",
    "mean-displacement": "a linear function of the mean displacement and its length",
}
R2_METRICS = tuple(
    Metric(f"r2_{name}", "R2", f"coefficient of determination of {name}, series not learned")
    for name in FORCES
)
MAE_METRICS = tuple(
    Metric(f"mae_{name}_n", "N", f"mean absolute error of {name}, series not learned")
    for name in FORCES
)
COVERAGE_METRICS = tuple(
    Metric(f"coverage90_{name}", "1", f"share of labels of {name} in the 90 % intervals")
    for name in FORCES
)
METRICS = (*R2_METRICS, *MAE_METRICS, *COVERAGE_METRICS)


def force_records(folder: Path, methods: list[str]) -> list[dict[str, Any]]:
    """Return the scores of every method on every series and on all pooled."""
    series = [load_series(path) for path in sorted((folder / FOLDER).glob("*.npz"))]
    records = []
    for method in methods:
        parts = []
        for left_out in series if len(series) > 1 else ():
            taught = [one for one in series if one is not left_out]
            parts.append((left_out.wrench[:, :3], *_predicted(method, taught, left_out)))
            name = f"{FOLDER}/{left_out.name.removesuffix('.npz')}"
            records.append(_record(method, name, *parts[-1]))
        if parts:
            truth, estimate, width = (np.concatenate(column) for column in zip(*parts, strict=True))
            records.append(_record(method, f"{FOLDER}/pooled", truth, estimate, width))
    return records


def _predicted(
    method: str, taught: list[WrenchSeries], left_out: WrenchSeries
) -> tuple[Field, Field]:
    if method == "mean-displacement":
        estimate = MeanDisplacement(one.in_image() for one in taught).estimate(left_out.in_image())
        return estimate[:, :3], np.full((len(estimate), 3), np.nan)
    trainer = network_trainer() if method == "network" else None
    model = fit_force(taught, trainer)
    values, widths = model.estimate(left_out)
    return values[:, :3], widths[:, :3]


def _record(method: str, case: str, truth: Field, estimate: Field, width: Field) -> dict[str, Any]:
    scores = {}
    for k, name in enumerate(FORCES):
        error = np.abs(truth[:, k] - estimate[:, k])
        scores[f"r2_{name}"] = r_squared(truth[:, k], estimate[:, k])
        scores[f"mae_{name}_n"] = float(error.mean())
        if np.isfinite(width).all():
            scores[f"coverage90_{name}"] = float((error <= width[:, k]).mean())
    trial = {"case": case, "groups": [], "seed": 0, "source": "recorded"}
    return {"method": method, "trial": trial, "scores": scores}
