"""The wrench of one field at a time, in one compiled pass: what a live estimate costs.

The same sums as :class:`~spikingtac.touch.force.stacked_laws.StackedLaws` and
:class:`~spikingtac.touch.force.novelty.Novelty` over many fields; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.touch.force.laws import NORMAL_FLOOR, ForceLaw
from spikingtac.touch.force.neighbourhood import AMPLITUDE_WEIGHT, WIDTH
from spikingtac.touch.force.novelty import Novelty
from spikingtac.touch.force.shape import PRODUCT_MODES, SHAPE_FLOOR, FieldBasis, shape_width

Field = NDArray[np.float64]

NARROWNESS = 0.5 / WIDTH**2
"""Factor of a squared distance in the exponent of a bump."""


class LinearWeights(NamedTuple):
    """Weights of everything that is linear in its features.

    Attributes:
        shape: ``(components, f)`` of the shape features.
        like: ``(components, c)`` of the likenesses.
        linear: ``(components, size)`` of the displacements.
        squares: ``(components, size)`` of their squares.
        offset: ``(components,)``.
    """

    shape: Field
    like: Field
    linear: Field
    squares: Field
    offset: Field


class _Basis(NamedTuple):
    modes: Field
    centers: Field
    center_squares: Field
    floors: Field
    deviation: Field


class _Normal(NamedTuple):
    component: NDArray[np.int64]
    weights: Field
    figures: Field


class OneField:
    """Estimates the wrench of single fields."""

    def __init__(
        self,
        weights: LinearWeights,
        normal: Sequence[tuple[int, float, ForceLaw]],
        basis: FieldBasis,
        novelty: Novelty,
    ) -> None:
        """Lay out the weights.

        Args:
            weights: Of all linear laws.
            normal: Component, share and law of each normal force.
            basis: What fields are described by.
            novelty: What distance to the learned fields is.
        """
        floors = np.array([SHAPE_FLOOR, NORMAL_FLOOR]) * np.sqrt(basis.dimensions)
        self._weights, self._edge = weights, novelty.edge
        self._basis = _Basis(
            np.ascontiguousarray(basis.modes.T),
            np.ascontiguousarray(basis.centers.T),
            basis.center_squares,
            floors,
            novelty.deviation,
        )
        self._normal = _laid_out(normal, shape_width(basis.modes.shape[1]))
        self._features = np.empty(shape_width(basis.modes.shape[1]))

    def __call__(self, field: Field) -> tuple[Field, float]:
        """Return components ``(c,)`` and distance of a field ``(size,)`` over the training rms."""
        out = np.empty(len(self._weights.offset))
        square = one_field_kernel(
            field, self._basis, self._weights, self._normal, self._features, out
        )
        return out, float(np.sqrt(square)) / self._edge


def _laid_out(normal: Sequence[tuple[int, float, ForceLaw]], width: int) -> _Normal:
    """Return the normal laws as arrays: ``figures`` are offset, share, sign, floor and cut."""
    weights, figures = np.zeros((len(normal), width + 1)), np.zeros((len(normal), 5))
    for row, (_, share, law) in enumerate(normal):
        weights[row] = law.ridge.weights / law.ridge.scale
        offset = law.ridge.offset - float(law.ridge.center @ weights[row])
        cut = float(np.log(law.largest_n + law.floor_n))
        figures[row] = offset, share, law.sign, law.floor_n, cut
    component = np.array([number for number, _, _ in normal], np.int64)
    return _Normal(component, weights, figures)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def one_field_kernel(
    field: Field,
    basis: _Basis,
    weights: LinearWeights,
    normal: _Normal,
    features: Field,
    out: Field,
) -> float:
    """Return the wrench of one field.

    Args:
        field: ``(size,)`` displacements over the training rms.
        basis: Modes ``(k, size)``, centers ``(k + 1, c)``, their squares, floors of the amplitude
            of shape and normal law, deviations of the leading modes.
        weights: Of the linear laws.
        normal: Of the normal laws.
        features: ``(f,)`` overwritten by the shape features.
        out: ``(components,)`` overwritten.

    Returns:
        Mean square of the leading coordinates over their deviations.
    """
    total = len(field)
    square = 0.0
    for i in range(total):
        square += field[i] * field[i]
    square /= total
    size = np.sqrt(square + basis.floors[0] ** 2)
    novelty = _features_kernel(field, size, basis, features)
    _linear_kernel(field, size, weights, features, out)
    _likeness_kernel(size, basis, weights.like, features, out)
    blunt = np.sqrt(square + basis.floors[1] ** 2)
    _normal_kernel(blunt, size, len(basis.modes), normal, features, out)
    return novelty


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def _features_kernel(field: Field, size: float, basis: _Basis, features: Field) -> float:
    """Fill the shape features; return the mean square of the leading coordinates."""
    modes, total = basis.modes, len(field)
    novelty, scale = 0.0, 1.0 / (size * np.sqrt(total))
    for k in range(len(modes)):
        along = 0.0
        for i in range(total):
            along += modes[k, i] * field[i]
        if k < len(basis.deviation):
            novelty += (along / basis.deviation[k]) ** 2
        features[k] = along * scale
    leading, slot = min(PRODUCT_MODES, len(modes)), len(modes)
    for first in range(leading):
        for second in range(first, leading):
            features[slot] = features[first] * features[second]
            slot += 1
    for k in range(leading, len(modes)):
        features[slot] = features[k] ** 2
        slot += 1
    return novelty / len(basis.deviation)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def _linear_kernel(
    field: Field, size: float, weights: LinearWeights, features: Field, out: Field
) -> None:
    """Fill the components with what is linear in shape, displacements and squares."""
    for component in range(len(out)):
        bent = 0.0
        for f in range(len(features)):
            bent += weights.shape[component, f] * features[f]
        told = 0.0
        for i in range(len(field)):
            slope = weights.linear[component, i] + weights.squares[component, i] * field[i]
            told += slope * field[i]
        out[component] = size * bent + told + weights.offset[component]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def _likeness_kernel(size: float, basis: _Basis, like: Field, features: Field, out: Field) -> None:
    """Add what is learned near remembered fields."""
    modes, logarithm = len(basis.centers) - 1, AMPLITUDE_WEIGHT * np.log(size)
    count, length = len(basis.center_squares), logarithm**2
    bumps = np.empty(count)
    for c in range(count):
        bumps[c] = basis.centers[modes, c] * logarithm
    # Center by center within a mode: neighbours in memory, so that several are taken at a time.
    for k in range(modes):
        feature = features[k]
        length += feature**2
        for c in range(count):
            bumps[c] += basis.centers[k, c] * feature
    for c in range(count):
        away = max(length + basis.center_squares[c] - 2.0 * bumps[c], 0.0)
        bumps[c] = size * np.exp(-NARROWNESS * away)
    for component in range(len(out)):
        added = 0.0
        for c in range(count):
            added += bumps[c] * like[component, c]
        out[component] += added


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, forceinline=True)
def _normal_kernel(
    blunt: float,
    size: float,
    modes: int,
    normal: _Normal,
    features: Field,
    out: Field,
) -> None:
    """Add the normal laws, whose shape is rounded off at another amplitude."""
    ratio = size / blunt
    for row in range(len(normal.component)):
        offset, share, sign, floor, cut = normal.figures[row]
        linear, bent = 0.0, 0.0
        for f in range(modes):
            linear += normal.weights[row, 1 + f] * features[f]
        for f in range(modes, len(features)):
            bent += normal.weights[row, 1 + f] * features[f]
        value = offset + normal.weights[row, 0] * np.log(blunt)
        value = min(value + ratio * linear + ratio**2 * bent, cut)
        out[normal.component[row]] += share * sign * (np.exp(value) - floor)
