"""All laws of a model in a few products: what makes an estimate cheap.

Every law but the normal one is linear in features that other laws use as well, so the weights of
all components are stacked over the features, and each feature is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.touch.force.laws import ComponentLaw, ForceLaw, coefficients
from spikingtac.touch.force.live.one_field import LinearWeights, OneField
from spikingtac.touch.force.novelty import Novelty
from spikingtac.touch.force.shape import SHAPE_FLOOR, FieldBasis, FieldFeatures, shape_width

Field = NDArray[np.float64]


class StackedLaws:
    """The components of a wrench from the features of fields."""

    def __init__(self, laws: Sequence[ComponentLaw], basis: FieldBasis) -> None:
        """Stack the laws of a model.

        Args:
            laws: One law per component.
            basis: What fields are described by.

        Raises:
            ConfigError: A law is not one of such fields.
        """
        self._basis = basis
        size, self._modes = basis.modes.shape
        self._width, components = shape_width(self._modes), len(laws)
        self._shape = np.zeros((self._width, components))
        self._like = np.zeros((len(basis.centers), components))
        self._linear = np.zeros((size, components))
        self._squares = np.zeros((size, components))
        self._offset = np.zeros(components)
        self._normal: list[tuple[int, float, ForceLaw]] = []
        for index, law in enumerate(laws):
            for part, share in zip(law.parts, law.shares, strict=True):
                self._add(index, share, part)
            if law.correction is not None:
                self._add(index, 1.0, law.correction)

        self._squared = bool(self._squares.any())

    def __call__(self, fields: FieldFeatures) -> Field:
        """Return the components ``(n, c)`` of fields."""
        moved = fields.displacement
        size, shape = fields.shape(SHAPE_FLOOR)
        bent = shape @ self._shape + fields.likeness() @ self._like
        out = size[:, None] * bent + moved @ self._linear + self._offset
        if self._squared:
            out += (moved * moved) @ self._squares
        for index, share, law in self._normal:
            out[:, index] += share * law(fields)
        return out

    def one_field(self, basis: FieldBasis, novelty: Novelty) -> OneField:
        """Return the same laws for one field at a time, with its distance."""
        weights = LinearWeights(
            np.ascontiguousarray(self._shape.T),
            np.ascontiguousarray(self._like.T),
            np.ascontiguousarray(self._linear.T),
            np.ascontiguousarray(self._squares.T),
            self._offset,
        )
        return OneField(weights, self._normal, basis, novelty)

    def _add(self, index: int, share: float, law: ForceLaw) -> None:
        expected = coefficients(law.family, self._basis)
        if len(law.ridge.weights) != expected:
            raise ConfigError(
                f"a law {law.family!r} has {len(law.ridge.weights)} coefficients, "
                f"these fields need {expected}"
            )
        if law.family == "normal":
            self._normal.append((index, share, law))
            return
        weights = share * law.ridge.weights / law.ridge.scale
        self._offset[index] += share * law.ridge.offset - float(law.ridge.center @ weights)
        own = {"shape": self._width, "kernel": self._width, "correction": self._modes}
        if law.family in own:
            count = own[law.family]
            self._shape[:count, index] += weights[:count]
            if len(weights) > count:
                self._like[:, index] += weights[count:]
            return
        self._linear[:, index] += weights[: len(self._linear)]
        if law.family == "squares":
            self._squares[:, index] += weights[len(self._linear) :]
