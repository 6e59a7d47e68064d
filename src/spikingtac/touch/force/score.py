"""The errors of a force model on a labelled series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.force.model import ForceModel
from spikingtac.touch.force.wrench_series import WrenchSeries

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ForceScore:
    """How well one component was estimated.

    Attributes:
        component: ``"fx"`` ... ``"mz"``.
        r2: Coefficient of determination against the labels.
        mae: Mean absolute error, N or Nm.
        coverage90: Share of the labels inside the 90 % intervals.
        n: Frames.
        unit: ``"N"`` or ``"Nm"``.
    """

    component: str
    r2: float
    mae: float
    coverage90: float
    n: int
    unit: str


def score_force(model: ForceModel, series: WrenchSeries) -> list[ForceScore]:
    """Score a model on a series with a wrench.

    Raises:
        ConfigError: The series holds no wrench, or does not fit the model.
    """
    if not len(series.t_us) or series.wrench.shape[1] < 3:
        raise ConfigError(f"{series.name} holds no wrench to compare with")
    values, widths, _ = model.estimate(series)
    rows = []
    for index, name in enumerate(model.components[: series.wrench.shape[1]]):
        truth, estimate = series.wrench[:, index], values[:, index]
        error = np.abs(truth - estimate)
        rows.append(
            ForceScore(
                name,
                r_squared(truth, estimate),
                float(error.mean()),
                float((error <= widths[:, index]).mean()),
                len(truth),
                "N" if name.startswith("f") else "Nm",
            )
        )
    return rows


def r_squared(truth: Field, estimate: Field) -> float:
    """Return 1 - (squared errors) / (squared deviations from the mean); 0 for constant truth."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    return 1.0 - float(((truth - estimate) ** 2).sum()) / spread if spread > 0.0 else 0.0
