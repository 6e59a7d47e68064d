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


class RidgeSystem:
    """A ridge regression before its target is known (Hoerl and Kennard, Technometrics 12, 1970).

    What costs most, the products of the features, is computed once however many targets follow.
    """

    def __init__(
        self,
        features: Field,
        penalty: Field,
        *,
        centred: bool = False,
        scaled: bool = False,
        row_weights: Field | None = None,
    ) -> None:
        """Multiply the features.

        Args:
            features: ``(n, f)``.
            penalty: ``(f,)`` penalty of each squared weight, per row of data.
            centred: Learn an offset; without it the map is zero at zero.
            scaled: Measure each feature in its own standard deviation.
            row_weights: ``(n,)`` weights of the rows, or None for equal ones.
        """
        rows, width = features.shape
        self._weight = np.ones(rows) if row_weights is None else row_weights / row_weights.mean()
        self._centred = centred
        self._center, self._scale = np.zeros(width), np.ones(width)
        if centred:
            self._center = self._weight @ features / rows
        if scaled:
            self._scale = np.maximum(features.std(axis=0), np.finfo(np.float64).tiny ** 0.25)
        self._x = (features - self._center) / self._scale
        weighted = self._x if row_weights is None else self._x * self._weight[:, None]
        self._gram = weighted.T @ self._x + np.diag(penalty * rows)

    def fit(self, target: Field) -> Ridge:
        """Return the map to targets ``(n,)``."""
        offset = float(self._weight @ target) / len(target) if self._centred else 0.0
        moment = (self._weight * (target - offset)) @ self._x
        weights = np.asarray(np.linalg.solve(self._gram, moment), np.float64)
        return Ridge(self._center, self._scale, weights, offset)
