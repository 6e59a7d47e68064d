"""What a force law sees of a displacement field: its amplitude and its shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.force.neighbourhood import (
    CENTERS,
    coordinates,
    evenly_chosen,
    likeness,
    whitening,
)
from spikingtac.touch.force.ridge import RidgeSystem

Field = NDArray[np.float64]

MODES = 40
"""Modes that describe a field (ours: 24 to 60 give the same errors on data/force)."""
PRODUCT_MODES = 24
"""Leading modes whose products are used (ours: 20 to 28 are alike; 12 costs 0.05 of R2 in the worst
normal force of data/force)."""
SMALL_SHARE = 0.16
"""Amplitude that is added to a field's before it is normalised for finding modes, as a share of
the rms: fields at rest are noise and have no shape (ours: 0.1 mm of 0.6 mm)."""


SHAPE_FLOOR = 0.35
"""Length of a marker's displacement below which a field has little shape, over the training rms
(ours: 0.3 mm of 0.85 mm on data/force)."""


def amplitude(displacement: Field, floor: float) -> Field:
    """Return the rms of fields ``(n, size)``, rounded off at ``floor``, ``(n,)``."""
    return np.sqrt((displacement**2).mean(axis=1) + floor**2)


def shape_modes(displacement: Field) -> Field:
    """Return the leading modes ``(size, modes)`` of fields ``(n, size)`` in units of their rms.

    The modes are principal directions of the normalised fields, so light contacts count as much
    as firm ones.
    """
    shapes = displacement / amplitude(displacement, SMALL_SHARE)[:, None]
    _, vectors = np.linalg.eigh(shapes.T @ shapes)
    return vectors[:, ::-1][:, : min(MODES, displacement.shape[1])]


@cache
def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.triu_indices(count)


def shape_width(modes: int) -> int:
    """Return the number of shape features of so many modes."""
    leading = min(PRODUCT_MODES, modes)
    return modes + leading * (leading + 1) // 2 + modes - leading


def shape_features(displacement: Field, modes: Field, floor: float) -> tuple[Field, Field]:
    """Return amplitude ``(n,)`` and shape features ``(n, f)`` of fields ``(n, size)``.

    The features are the field's coordinates along the modes over its amplitude, the products of
    the leading ones and the squares of the others: a quadratic function of the shape alone.
    """
    size = amplitude(displacement, floor)
    shape = displacement @ modes / (size[:, None] * np.sqrt(len(modes)))
    leading = min(PRODUCT_MODES, modes.shape[1])
    first, second = _pairs(leading)
    products = shape[:, first] * shape[:, second]
    return size, np.hstack([shape, products, shape[:, leading:] ** 2])


@dataclass(frozen=True)
class FieldBasis:
    """What fields are described by.

    Attributes:
        modes: ``(size, k)`` modes.
        centers: ``(c, k + 1)`` remembered fields.
        dimensions: Coordinates of a marker, 2 or 3.
    """

    modes: Field
    centers: Field
    dimensions: int

    @cached_property
    def center_squares(self) -> Field:
        """``(c,)`` squared length of each remembered place."""
        return (self.centers**2).sum(axis=1)

    @cached_property
    def whitening(self) -> Field:
        """What :func:`whitening` says of the remembered places."""
        return whitening(self.centers)

    @classmethod
    def learn(
        cls,
        displacement: Field,
        dimensions: int,
        centers: int = CENTERS,
        choose: Callable[[Field, int], Field] = evenly_chosen,
    ) -> FieldBasis:
        """Learn from training fields ``(n, size)`` in units of their rms.

        Args:
            displacement: The fields.
            dimensions: Coordinates of a marker.
            centers: Fields to remember.
            choose: Returns so many of their places.
        """
        modes = shape_modes(displacement)
        size, shape = shape_features(displacement, modes, SHAPE_FLOOR * np.sqrt(dimensions))
        places = coordinates(size, shape[:, : modes.shape[1]])
        return cls(modes, choose(places, centers), dimensions)


class FieldFeatures:
    """The features of some fields, each computed once however many laws ask for it."""

    def __init__(self, displacement: Field, basis: FieldBasis) -> None:
        """Take fields ``(n, size)`` in units of the training rms."""
        self.displacement, self.basis = displacement, basis
        self._shapes: dict[float, tuple[Field, Field]] = {}
        self._likeness: Field | None = None
        self._systems: dict[str, RidgeSystem] = {}

    def kept(self, family: str, system: Callable[[], RidgeSystem]) -> RidgeSystem:
        """Return the regression of a family of laws on these fields, made at the first call."""
        if family not in self._systems:
            self._systems[family] = system()
        return self._systems[family]

    def shape(self, floor: float) -> tuple[Field, Field]:
        """Return :func:`shape_features` with the amplitude rounded at a marker's length."""
        if floor not in self._shapes:
            self._shapes[floor] = self._shape(floor * float(np.sqrt(self.basis.dimensions)))
        return self._shapes[floor]

    def _shape(self, floor: float) -> tuple[Field, Field]:
        """Return the features, from those of another floor where there are some."""
        if not self._shapes:
            return shape_features(self.displacement, self.basis.modes, floor)
        other, features = next(iter(self._shapes.values()))
        size = amplitude(self.displacement, floor)
        ratio = (other / size)[:, None]
        scaled = features * ratio**2
        along = self.basis.modes.shape[1]
        scaled[:, :along] = features[:, :along] * ratio
        return size, scaled

    def likeness(self) -> Field:
        """Return the likeness ``(n, c)`` to the remembered fields."""
        if self._likeness is None:
            size, shape = self.shape(SHAPE_FLOOR)
            places = coordinates(size, shape[:, : self.basis.modes.shape[1]])
            self._likeness = likeness(places, self.basis.centers, self.basis.center_squares)
        return self._likeness
