"""How far a field is from those that a model was taught: the end of what it can know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.force.shape import PRODUCT_MODES

Field = NDArray[np.float64]

TAUGHT_SHARE = 0.995
"""Share of the training fields that lie within a distance of 1 (ours)."""
LEAST_VARIANCE_SHARE = 1e-3
"""Modes of less than this share of the largest variance are measured as if they had it."""


@dataclass(frozen=True, slots=True)
class Novelty:
    """A Mahalanobis distance in the leading modes, 1 at the edge of the training fields.

    Attributes:
        deviation: ``(k,)`` standard deviation of the training fields along each mode, about rest.
        edge: Unscaled distance of the training fields' edge.
    """

    deviation: Field
    edge: float

    def __call__(self, displacement: Field, modes: Field) -> Field:
        """Return the distances ``(n,)`` of fields ``(n, size)``."""
        along = displacement @ modes[:, : len(self.deviation)]
        return np.sqrt(((along / self.deviation) ** 2).mean(axis=1)) / self.edge


def learn_novelty(displacement: Field, modes: Field) -> Novelty:
    """Learn the distance from training fields ``(n, size)``."""
    along = displacement @ modes[:, :PRODUCT_MODES]
    variance = (along**2).mean(axis=0)
    deviation = np.sqrt(np.maximum(variance, LEAST_VARIANCE_SHARE * variance.max()))
    reach = np.sqrt(((along / deviation) ** 2).mean(axis=1))
    return Novelty(deviation, float(np.quantile(reach, TAUGHT_SHARE)))
