"""Linear regression with a penalty: the one solver behind every force law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ridge:
    """A fitted linear map ``(x - center) / scale @ weights + offset``.

    Attributes:
        center: ``(f,)`` subtracted from the features.
        scale: ``(f,)`` divides them.
        weights: ``(f,)``.
        offset: Added to the result.
    """

    center: Field
    scale: Field
    weights: Field
    offset: float

    def __call__(self, features: Field) -> Field:
        """Return the map's value for ``(n, f)`` features, ``(n,)``."""
        return ((features - self.center) / self.scale) @ self.weights + self.offset


def fit_ridge(
    features: Field,
    target: Field,
    penalty: Field,
    *,
    centred: bool = False,
    scaled: bool = False,
    row_weights: Field | None = None,
) -> Ridge:
    """Fit a ridge regression (Hoerl and Kennard, Technometrics 12, 1970).

    Args:
        features: ``(n, f)``.
        target: ``(n,)``.
        penalty: ``(f,)`` penalty of each squared weight, per row of data.
        centred: Learn an offset; without it the map is zero at zero.
        scaled: Measure each feature in its own standard deviation.
        row_weights: ``(n,)`` weights of the rows, or None for equal ones.
    """
    rows, width = features.shape
    weight = np.ones(rows) if row_weights is None else row_weights / row_weights.mean()
    center, offset = np.zeros(width), 0.0
    if centred:
        center = weight @ features / rows
        offset = float(weight @ target) / rows
    scale = np.ones(width)
    if scaled:
        scale = np.maximum(features.std(axis=0), np.finfo(np.float64).tiny ** 0.25)
    x = (features - center) / scale
    gram = (x * weight[:, None]).T @ x + np.diag(penalty * rows)
    moment = (x * weight[:, None]).T @ (target - offset)
    weights = np.asarray(np.linalg.solve(gram, moment), np.float64)
    return Ridge(center, scale, weights, offset)
