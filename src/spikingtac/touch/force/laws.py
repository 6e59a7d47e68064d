"""The force laws: short formulas with few hyperparameters, each linear in what is fitted.

``shape``: amplitude times a quadratic function of the field's shape. Elastic contact of one shape
is linear in amplitude; which line it follows depends on the shape. Zero at rest by construction.

``squares``: a linear function of every marker's displacement and its square, with an offset.

``normal``: the normal force grows faster than the amplitude when a contact spreads, and never
pulls: its logarithm is the logarithm of the amplitude times an exponent, plus a quadratic function
of the shape. So a contact wider than any that was learned is extrapolated as a power law.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.force.ridge import Ridge, fit_ridge
from spikingtac.touch.force.shape import shape_features

Field = NDArray[np.float64]
Family = Literal["shape", "squares", "normal"]

SHAPE_FLOOR = 0.35
"""Length of a marker's displacement below which a field has little shape, over the training rms
(ours: 0.3 mm of 0.85 mm on data/force)."""
NORMAL_FLOOR = 0.67
"""The same for the normal law (ours: 0.6 to 0.7 give the same errors within 0.01 of R2)."""
SHAPE_PENALTY = 5e-5
"""Ridge penalty per row of the law ``shape`` (ours: 2e-5 to 1e-4 are alike)."""
SQUARES_PENALTY = 3e-2
"""Ridge penalty per row of the law ``squares`` (ours: 1.5e-2 to 1e-1 are alike)."""
NORMAL_PENALTY = 1e-4
"""Ridge penalty per row of the law ``normal`` (ours: 6e-5 to 1.6e-4 are alike)."""
FORCE_FLOOR_SHARE = 0.06
"""Force added before the logarithm, as a share of the rms normal force (ours: 0.15 N of 2.5)."""
FORCE_LEAST_SHARE = 0.04
"""Normal forces below this share of their rms teach the logarithm nothing (ours: 0.1 N)."""
ROW_WEIGHT_POWER = 0.75
"""Rows of the normal law weigh by force to this power: between equal relative errors (0) and equal
errors in N (2) (ours: 0.5 to 1.5 are alike)."""
LARGEST_RATIO = 4.0
"""Largest normal force that is ever told, over the largest learned: the exponential is cut here."""


@dataclass(frozen=True, slots=True)
class ForceLaw:
    """One fitted law of one component.

    Attributes:
        family: Which formula.
        ridge: Its coefficients.
        floor: Rounding of the amplitude, in units of the training rms.
        sign: Sign of the normal force in the sensor's frame (1 for the others).
        floor_n: Force added before the logarithm, N (law ``normal``).
        largest_n: Where the normal law is cut, N.
    """

    family: Family
    ridge: Ridge
    floor: float = 0.0
    sign: float = 1.0
    floor_n: float = 0.0
    largest_n: float = float("inf")

    def __call__(self, displacement: Field, modes: Field) -> Field:
        """Return the component ``(n,)`` of fields ``(n, size)`` in units of the training rms."""
        if self.family == "squares":
            return self.ridge(_squares(displacement))
        if self.family == "shape":
            size, shape = shape_features(displacement, modes, self.floor)
            return self.ridge(size[:, None] * shape)
        logarithm = np.minimum(
            self.ridge(_normal(displacement, modes, self.floor)),
            np.log(self.largest_n + self.floor_n),
        )
        return self.sign * (np.exp(logarithm) - self.floor_n)


@dataclass(frozen=True, slots=True)
class ComponentLaw:
    """The law of one component of the wrench: the mean of one or two formulas.

    Attributes:
        parts: The formulas.
    """

    parts: tuple[ForceLaw, ...]

    def __call__(self, displacement: Field, modes: Field) -> Field:
        """Return the component ``(n,)`` of fields ``(n, size)`` in units of the training rms."""
        return np.mean([part(displacement, modes) for part in self.parts], axis=0)


def fit_component(
    families: tuple[Family, ...], displacement: Field, modes: Field, force: Field, dimensions: int
) -> ComponentLaw:
    """Fit one component.

    Args:
        families: The formulas whose mean is taken.
        displacement: ``(n, size)`` fields in units of their rms.
        modes: ``(size, k)`` modes of the field.
        force: ``(n,)`` the component, N or Nm.
        dimensions: Coordinates of a marker, 2 or 3.
    """
    root = float(np.sqrt(dimensions))
    fits = {"shape": _fit_shape, "squares": _fit_squares, "normal": _fit_normal}
    return ComponentLaw(
        tuple(fits[family](displacement, modes, force, root) for family in families)
    )


def _fit_shape(displacement: Field, modes: Field, force: Field, root: float) -> ForceLaw:
    floor = SHAPE_FLOOR * root
    size, shape = shape_features(displacement, modes, floor)
    penalty = np.full(shape.shape[1], SHAPE_PENALTY)
    return ForceLaw("shape", fit_ridge(size[:, None] * shape, force, penalty), floor)


def _fit_squares(displacement: Field, modes: Field, force: Field, root: float) -> ForceLaw:
    features = _squares(displacement)
    penalty = np.full(features.shape[1], SQUARES_PENALTY)
    return ForceLaw("squares", fit_ridge(features, force, penalty, centred=True, scaled=True))


def _fit_normal(displacement: Field, modes: Field, force: Field, root: float) -> ForceLaw:
    sign = -1.0 if float(np.sum(force)) < 0 else 1.0
    pressing = sign * force
    rms = float(np.sqrt(np.mean(force**2)))
    force_floor, taught = FORCE_FLOOR_SHARE * rms, pressing > FORCE_LEAST_SHARE * rms
    if taught.sum() < displacement.shape[1] // 2:
        return _fit_shape(displacement, modes, force, root)
    floor = NORMAL_FLOOR * root
    features = _normal(displacement[taught], modes, floor)
    penalty = np.full(features.shape[1], NORMAL_PENALTY)
    penalty[0] = 0.0
    ridge = fit_ridge(
        features,
        np.log(pressing[taught] + force_floor),
        penalty,
        centred=True,
        row_weights=pressing[taught] ** ROW_WEIGHT_POWER,
    )
    largest = LARGEST_RATIO * float(pressing.max())
    return ForceLaw("normal", ridge, floor, sign, force_floor, largest)


def _normal(displacement: Field, modes: Field, floor: float) -> Field:
    size, shape = shape_features(displacement, modes, floor)
    return np.column_stack([np.log(size), shape])


def _squares(displacement: Field) -> Field:
    return np.hstack([displacement, displacement**2])
