"""The coefficient of determination."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


def r_squared(truth: Field, estimate: Field) -> float:
    """Return 1 - (squared errors) / (squared deviations from the mean); 0 for constant truth."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    return 1.0 - float(((truth - estimate) ** 2).sum()) / spread if spread > 0.0 else 0.0
