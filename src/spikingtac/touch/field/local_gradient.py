"""How the skin is deformed at each marker: the gradient of the displacement field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

Field = NDArray[np.float64]

NEIGHBOURS = 9
"""Markers whose displacements make a gradient, the marker itself included: the 3 by 3 block of a
square grid, or half of it at the border."""
LEAST_MARKERS = 4
"""Fewer markers do not span a gradient with an error to judge it by."""


@dataclass(frozen=True, slots=True)
class Gradients:
    """The gradient of the displacement field at every marker, over ``(..., m)``.

    Attributes:
        divergence: Growth of area, d u_x / dx + d u_y / dy.
        curl: Twice the rotation angle, d u_y / dx - d u_x / dy, rad.
        stretch: Elongation along x less that along y, d u_x / dx - d u_y / dy.
        skew: Shear strain, d u_x / dy + d u_y / dx.
    """

    divergence: Field
    curl: Field
    stretch: Field
    skew: Field

    @property
    def local(self) -> Field:
        """Length of the whole gradient at each marker, ``(..., m)``."""
        return np.sqrt(self.divergence**2 + self.curl**2 + self.stretch**2 + self.skew**2)

    @property
    def strength(self) -> Field:
        """Root mean square of the whole gradient over the markers, ``(...)``."""
        return np.sqrt((self.local**2).mean(axis=-1))


class GradientOperator:
    """Local least squares on the nearest markers, precomputed for one sensor.

    Example:
        >>> axes = np.meshgrid(np.arange(4.0), np.arange(4.0))
        >>> place = np.column_stack([axis.ravel() for axis in axes])
        >>> GradientOperator(place).of(0.1 * place).divergence.round(6).max()
        np.float64(0.2)
    """

    def __init__(self, reference: Field) -> None:
        """Prepare the operator.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.

        Raises:
            ConfigError: Too few markers.
        """
        markers = len(reference)
        if markers < LEAST_MARKERS:
            raise ConfigError(
                f"{markers} markers span no field, at least {LEAST_MARKERS} are needed"
            )
        self._along = np.zeros((2, markers, markers))
        near = min(NEIGHBOURS, markers)
        for marker, place in enumerate(reference):
            away = reference - place
            chosen = np.argsort((away**2).sum(axis=1), kind="stable")[:near]
            rows = np.column_stack([np.ones(near), away[chosen]])
            self._along[:, marker, chosen] = np.linalg.pinv(rows)[1:]

    def of(self, displacement: Field) -> Gradients:
        """Return the gradients of displacements ``(..., m, 2)``."""
        slopes = np.matmul(self._along, displacement[..., None, :, :])
        x_by_x, y_by_x = slopes[..., 0, :, 0], slopes[..., 0, :, 1]
        x_by_y, y_by_y = slopes[..., 1, :, 0], slopes[..., 1, :, 1]
        return Gradients(x_by_x + y_by_y, y_by_x - x_by_y, x_by_x - y_by_y, x_by_y + y_by_x)

    def noise_gain(self) -> float:
        """Return the strength of the gradients of white noise of one px per axis."""
        return float(np.sqrt(4.0 * (self._along**2).sum() / (self._along.shape[1])))
