"""A force model for another sensor of the same kind, from a few labelled presses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from spikingtac.errors import ConfigError
from spikingtac.touch.force.fit import (
    COVERAGE,
    TINY,
    check_series,
    r_squared,
    relative_error,
    rest_of,
)
from spikingtac.touch.force.model import ForceModel, Target, fields_of
from spikingtac.touch.force.series import COMPONENTS, WrenchSeries

Field = NDArray[np.float64]

LEAST_PRESSES = 20  # Fewer labelled frames make no model of another sensor.

# Displacements of the learned sensor over those of another one under the same force.
SOFTNESS = np.geomspace(0.4, 2.5, 13)

# Weight of the gain that the largest force alone would ask for, beside the frames'.
GAIN_PRIOR = 0.05


def retarget(model: ForceModel, series: Sequence[WrenchSeries]) -> ForceModel:
    """Return a model for the sensor of some labelled presses.

    The displacements of its markers are interpolated at the places of the learned ones; a factor of
    softness, and a linear map of the wrench, are fitted to the presses.

    Args:
        model: Learned on another sensor.
        series: Presses, each from its own rest; as many components as the model has.

    Raises:
        ConfigError: There are too few, or they do not fit each other or the model.
    """
    kept, count = [one.in_image() for one in series], len(model.components)
    if sum(len(one.t_us) for one in kept) < LEAST_PRESSES:
        raise ConfigError(f"a model is re-targeted from {LEAST_PRESSES} labelled frames at least")
    check_series(kept, count, kept[0].reference)
    reference, radius = rest_of(kept)
    fields = np.concatenate([fields_of(one, radius, model.memory) for one in kept])
    wrench = np.concatenate([one.wrench[:, :count] for one in kept])
    candidates = [_fitted_target(model, factor, reference, fields, wrench) for factor in SOFTNESS]
    target, told = min(candidates, key=lambda pair: relative_error(pair[1], wrench))
    floor = np.quantile(np.abs(told - wrench), COVERAGE, axis=0)
    scores = [round(r_squared(*pair), 4) for pair in zip(wrench.T, told.T, strict=True)]
    return model.with_record(
        {
            "unit": kept[0].unit,
            "reference": reference.round(5).tolist(),
            "rest_radius": radius,
            "target": {name: part.round(7).tolist() for name, part in target._asdict().items()},
            "interval": [[float(one), 0.0, 0.0] for one in floor],
            "retargeted_with": [one.name for one in kept],
            "r2_between_series": dict(zip(COMPONENTS, scores, strict=False)),
            "frames": len(wrench),
        }
    )


def _fitted_target(
    model: ForceModel, softness: float, reference: Field, fields: Field, wrench: Field
) -> tuple[Target, Field]:
    """Return the target of a softness with its best gain, and what is then told of the fields."""
    scale = float((np.ptp(model.reference, axis=0) / np.ptp(reference, axis=0)).mean())
    places = (model.reference - model.reference.mean(axis=0)) / scale + reference.mean(axis=0)
    resample = softness * scale * RBFInterpolator(reference, np.eye(len(reference)))(places)
    told = model.network(Target(resample, np.eye(wrench.shape[1])).fields(fields))[0]
    size = np.sqrt((told**2).mean(axis=0)) + TINY
    rows = told / size
    start = np.diag((rows * wrench).mean(axis=0))
    prior = GAIN_PRIOR * len(rows)
    square = rows.T @ rows + prior * np.eye(len(size))
    gain = np.linalg.solve(square, rows.T @ wrench + prior * start) / size[:, None]
    return Target(resample, gain), told @ gain
