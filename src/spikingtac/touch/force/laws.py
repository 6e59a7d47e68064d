"""The force laws: short formulas with few hyperparameters, each linear in what is fitted.

``shape``: amplitude times a quadratic function of the field's shape. Elastic contact of one shape
is linear in amplitude; which line it follows depends on the shape. Zero at rest by construction.

``linear``: a linear function of every marker's displacement, with an offset.

``squares``: the same of every displacement and its square.

``kernel``: as ``shape``, plus what is particular to fields like those that were learned.

``normal``: the normal force grows faster than the amplitude when a contact spreads, and never
pulls: its logarithm is the logarithm of the amplitude times an exponent, plus a quadratic function
of the shape. So a contact wider than any that was learned is extrapolated as a power law.

``correction``: amplitude times a function of the likeness to learned fields; it is fitted to what
another law leaves and vanishes far from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.force.ridge import Ridge, RidgeSystem
from spikingtac.touch.force.shape import (
    PRODUCT_MODES,
    SHAPE_FLOOR,
    FieldBasis,
    FieldFeatures,
    shape_width,
)

Field = NDArray[np.float64]
Family = Literal["shape", "linear", "squares", "kernel", "normal", "correction"]
FAMILIES: tuple[Family, ...] = get_args(Family)

NORMAL_FLOOR = 0.85
"""Length of a marker's displacement below which a field has little shape for the normal law, over
the training rms (ours: 0.67 and 0.85 are alike in the image, with depth 0.85 errs less)."""
SHAPE_PENALTY = 5e-5
"""Ridge penalty per row of the law ``shape`` (ours: 2e-5 to 2e-4 are alike)."""
SQUARES_PENALTY = 3e-2
"""Ridge penalty per row of ``linear`` and ``squares`` (ours: 1.5e-2 to 1e-1 are alike)."""
NORMAL_PENALTY = 1e-4
"""Ridge penalty per row of the law ``normal`` (ours: 6e-5 to 1.6e-4 are alike)."""
KERNEL_PENALTY = 1e-4
"""Ridge penalty per row of ``kernel`` (ours: 1e-5 to 5e-4 were tried; less errs more between
series, more errs more within them)."""
CORRECTION_PENALTY = 2e-4
"""The same of ``correction`` (ours: 1e-4 is better in the image, 4e-4 with depth)."""
PRODUCT_PRIOR = 0.1
"""Prior variance of the products' weights in ``kernel`` over that of the shape's (ours)."""
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
        sign: Sign of the normal force in the sensor's frame (1 for the others).
        floor_n: Force added before the logarithm, N (law ``normal``).
        largest_n: Where the normal law is cut, N.
    """

    family: Family
    ridge: Ridge
    sign: float = 1.0
    floor_n: float = 0.0
    largest_n: float = float("inf")

    def __call__(self, fields: FieldFeatures) -> Field:
        """Return the component ``(n,)`` of fields."""
        value = self.ridge(_FEATURES[self.family](fields))
        if self.family != "normal":
            return value
        logarithm = np.minimum(value, np.log(self.largest_n + self.floor_n))
        return self.sign * (np.exp(logarithm) - self.floor_n)


@dataclass(frozen=True, slots=True)
class ComponentLaw:
    """The law of one component of the wrench: the mean of some formulas, and a correction.

    Attributes:
        parts: The formulas.
        shares: Weight of each; they sum to 1.
        correction: What is added near learned fields, or None.
    """

    parts: tuple[ForceLaw, ...]
    shares: tuple[float, ...]
    correction: ForceLaw | None = None

    @property
    def name(self) -> str:
        """The formulas' names, for a table."""
        names = [part.family for part in self.parts]
        return ", ".join(names if self.correction is None else [*names, self.correction.family])

    def __call__(self, fields: FieldFeatures) -> Field:
        """Return the component ``(n,)`` of fields."""
        value = sum(
            (share * part(fields) for part, share in zip(self.parts, self.shares, strict=True)),
            np.zeros(len(fields.displacement)),
        )
        return value if self.correction is None else value + self.correction(fields)


@dataclass(frozen=True, slots=True)
class LawChoice:
    """Which formulas may describe a component.

    Attributes:
        families: The formulas whose mean is taken; one named twice weighs twice.
        corrected: Whether a correction near learned fields is added.
    """

    families: tuple[Family, ...]
    corrected: bool = False


def fit_component(choice: LawChoice, fields: FieldFeatures, force: Field) -> ComponentLaw:
    """Fit one component.

    Args:
        choice: The formulas.
        fields: The training fields.
        force: ``(n,)`` the component, N or Nm.
    """
    families = tuple(dict.fromkeys(choice.families))
    shares = tuple(choice.families.count(name) / len(choice.families) for name in families)
    law = ComponentLaw(tuple(_FITS[name](fields, force) for name in families), shares)
    if not choice.corrected:
        return law
    return ComponentLaw(law.parts, shares, _fit_near("correction", fields, force - law(fields)))


def coefficients(family: Family, basis: FieldBasis) -> int:
    """Return how many coefficients a law of a family has on fields of a basis."""
    size, modes = basis.modes.shape
    shape, like = shape_width(modes), len(basis.centers)
    counts = {"shape": shape, "linear": size, "squares": 2 * size, "kernel": shape + like}
    return (counts | {"normal": shape + 1, "correction": modes + like})[family]


def _shape(fields: FieldFeatures) -> Field:
    size, shape = fields.shape(SHAPE_FLOOR)
    return size[:, None] * shape


def _linear(fields: FieldFeatures) -> Field:
    return fields.displacement


def _squares(fields: FieldFeatures) -> Field:
    return np.hstack([fields.displacement, fields.displacement**2])


def _normal(fields: FieldFeatures) -> Field:
    size, shape = fields.shape(NORMAL_FLOOR)
    return np.column_stack([np.log(size), shape])


def _kernel(fields: FieldFeatures) -> Field:
    size, shape = fields.shape(SHAPE_FLOOR)
    return size[:, None] * np.hstack([shape, fields.likeness()])


def _correction(fields: FieldFeatures) -> Field:
    size, shape = fields.shape(SHAPE_FLOOR)
    along = shape[:, : fields.basis.modes.shape[1]]
    return size[:, None] * np.hstack([along, fields.likeness()])


_FEATURES: dict[Family, Callable[[FieldFeatures], Field]] = {
    "shape": _shape,
    "linear": _linear,
    "squares": _squares,
    "kernel": _kernel,
    "normal": _normal,
    "correction": _correction,
}


def _fit_shape(fields: FieldFeatures, force: Field) -> ForceLaw:
    def system() -> RidgeSystem:
        features = _shape(fields)
        return RidgeSystem(features, np.full(features.shape[1], SHAPE_PENALTY))

    return ForceLaw("shape", fields.kept("shape", system).fit(force))


def _fit_linear(fields: FieldFeatures, force: Field) -> ForceLaw:
    return _fit_scaled("linear", fields, force)


def _fit_squares(fields: FieldFeatures, force: Field) -> ForceLaw:
    return _fit_scaled("squares", fields, force)


def _fit_scaled(family: Family, fields: FieldFeatures, force: Field) -> ForceLaw:
    def system() -> RidgeSystem:
        features = _FEATURES[family](fields)
        penalty = np.full(features.shape[1], SQUARES_PENALTY)
        return RidgeSystem(features, penalty, centred=True, scaled=True)

    return ForceLaw(family, fields.kept(family, system).fit(force))


def _fit_kernel(fields: FieldFeatures, force: Field) -> ForceLaw:
    return _fit_near("kernel", fields, force)


def _fit_near(family: Family, fields: FieldFeatures, force: Field) -> ForceLaw:
    """Fit a law whose last features are likenesses, with a Gaussian process's prior on them."""
    ridge = fields.kept(family, lambda: _near_system(family, fields)).fit(force)
    white = fields.basis.whitening
    own = len(ridge.weights) - white.shape[1]
    weights = np.concatenate([ridge.weights[:own], white @ ridge.weights[own:]])
    zeros = np.zeros(len(weights))
    return ForceLaw(family, Ridge(zeros, zeros + 1.0, weights, 0.0))


def _near_system(family: Family, fields: FieldFeatures) -> RidgeSystem:
    features, basis = _FEATURES[family](fields), fields.basis
    own, along = features.shape[1] - len(basis.centers), basis.modes.shape[1]
    whitened = np.hstack([features[:, :own], features[:, own:] @ basis.whitening])
    strength = KERNEL_PENALTY if family == "kernel" else CORRECTION_PENALTY
    penalty = np.full(whitened.shape[1], strength)
    if family == "kernel":
        first, second = np.triu_indices(min(PRODUCT_MODES, along))
        mixed = np.where(first == second, 1.0, 2.0)
        penalty[along : along + len(mixed)] /= PRODUCT_PRIOR * mixed
        penalty[along + len(mixed) : own] /= PRODUCT_PRIOR
    return RidgeSystem(whitened, penalty)


def _fit_normal(fields: FieldFeatures, force: Field) -> ForceLaw:
    sign = -1.0 if float(np.sum(force)) < 0 else 1.0
    pressing = sign * force
    rms = float(np.sqrt(np.mean(force**2)))
    force_floor, taught = FORCE_FLOOR_SHARE * rms, pressing > FORCE_LEAST_SHARE * rms
    if taught.sum() < fields.displacement.shape[1] // 2:
        return _fit_shape(fields, force)
    features = _normal(fields)[taught]
    penalty = np.full(features.shape[1], NORMAL_PENALTY)
    penalty[0] = 0.0
    row_weights = pressing[taught] ** ROW_WEIGHT_POWER
    system = RidgeSystem(features, penalty, centred=True, row_weights=row_weights)
    ridge = system.fit(np.log(pressing[taught] + force_floor))
    largest = LARGEST_RATIO * float(pressing.max())
    return ForceLaw("normal", ridge, sign, force_floor, largest)


_FITS: dict[Family, Callable[[FieldFeatures, Field], ForceLaw]] = {
    "shape": _fit_shape,
    "linear": _fit_linear,
    "squares": _fit_squares,
    "kernel": _fit_kernel,
    "normal": _fit_normal,
}
