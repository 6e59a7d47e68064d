"""The elastic layer on a grid: displacement under traction, and its values at the markers.

The layer is incompressible, linear and isotropic, bonded to a rigid base, of thickness h. Frame: x
right, y down, z into the layer (towards the camera), so that pressure and indentation are positive.
All responses are for unit shear modulus; multiply by the compliance 1/mu.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.sparse import csr_array

from spikingtac.schema import require_within
from spikingtac.touch.elastic import layer_response
from spikingtac.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class GridConfig:
    """The square, periodic grid on which tractions and displacements live.

    Attributes:
        cells: Cells along each side (64; 128 where contacts are finer than 0.5 mm).
        span_mm: Side of the square, mm (the 20.6 mm field and a rim of about one thickness).
    """

    cells: int = 64
    span_mm: float = 26.0

    def __post_init__(self) -> None:
        require_within(self, cells=(8, 512), span_mm=(0.5, 500.0))
        if self.cells % 2:
            raise ValueError(f"cells is {self.cells}, it must be even")

    @property
    def pitch_mm(self) -> float:
        """Side of a cell, mm."""
        return self.span_mm / self.cells

    @property
    def axis_mm(self) -> FloatArray:
        """Cell centres along one side, symmetric about zero, mm."""
        return (np.arange(self.cells, dtype=np.float64) - 0.5 * (self.cells - 1)) * self.pitch_mm


class LayerOperator:
    """Surface displacement of one layer under any traction on a grid.

    Attributes:
        tables: ``(6, n, n)`` displacement (mm at unit modulus) at an offset in cells ``[dy, dx]``
            (modulo n) from a cell under unit traction: x<-x, x<-y, y<-y, z<-z, x<-z, y<-z. The
            last two change sign for z<-x and z<-y (reciprocity).
    """

    def __init__(self, grid: GridConfig, thickness_mm: float) -> None:
        self._grid = grid
        n, step = grid.cells, 2.0 * np.pi / grid.span_mm
        index = np.arange(n, dtype=np.float64)[:, None]
        ky = step * np.where(index > n // 2, index - n, index)
        kx = step * index[: n // 2 + 1].T
        k = np.hypot(kx, ky)
        normal, coupling, along, across = layer_response(k, thickness_mm)
        lateral, length = along - across, np.where(k > 0.0, k, 1.0)
        cx, cy = kx / length, ky / length
        even = [across + lateral * cx * cx, lateral * cx * cy, across + lateral * cy * cy]
        self._even = np.stack([*even, normal])
        odd = np.stack((cx * coupling, cy * coupling))
        # What is odd in kx or ky has no value at the highest frequency of an even grid.
        for kernel in (self._even[1], *odd):
            kernel[n // 2, :] = 0.0
            kernel[:, n // 2] = 0.0
        self._odd = -1j * odd
        spectra = np.concatenate((self._even + 0j, self._odd))
        self.tables = np.asarray(scipy.fft.irfft2(spectra, s=(n, n), workers=1), np.float64)

    def displacements(self, traction: FloatArray) -> FloatArray:
        """Return the displacement field of a traction field.

        Args:
            traction: ``(3, n, n)`` shear along x and y, and pressure, N/mm².

        Returns:
            ``(3, n, n)`` displacement along x, y and into the layer, mm at unit modulus.
        """
        n = self._grid.cells
        x, y, z = np.asarray(scipy.fft.rfft2(traction, workers=1))
        (xx, xy, yy, zz), (xz, yz) = self._even, self._odd
        along = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z
        moved_k = np.stack((*along, zz * z - xz * x - yz * y))
        return np.asarray(scipy.fft.irfft2(moved_k, s=(n, n), workers=1, overwrite_x=True), float)


_STENCIL = np.arange(-2, 4)


class MarkerInterpolation:
    """Quintic Lagrange interpolation on 6 by 6 cells. The weights are computed once.

    Args:
        grid: The grid.
        points_mm: ``(m, 2)`` points (x, y), mm. The grid repeats beyond its span.
    """

    def __init__(self, grid: GridConfig, points_mm: FloatArray) -> None:
        scaled = (points_mm - grid.axis_mm[0]) / grid.pitch_mm
        base = np.floor(scaled).astype(np.int64)
        values, slopes = _lagrange(scaled - base)
        columns = (base[:, 0, None] + _STENCIL) % grid.cells
        rows = (base[:, 1, None] + _STENCIL) % grid.cells
        near = (rows[:, :, None] * grid.cells + columns[:, None, :]).ravel()
        outer = "mi,mj->mij"
        weights = [
            np.einsum(outer, values[:, 1], values[:, 0]),
            np.einsum(outer, values[:, 1], slopes[:, 0]) / grid.pitch_mm,
            np.einsum(outer, slopes[:, 1], values[:, 0]) / grid.pitch_mm,
        ]
        ends = np.arange(3 * len(base) + 1) * len(_STENCIL) ** 2
        parts = np.stack(weights).ravel(), np.tile(near, 3), ends
        self._matrix = csr_array(parts, shape=(3 * len(base), grid.cells**2))

    def at_markers(self, displacement_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return displacement and in-plane gradient at the points.

        Args:
            displacement_mm: ``(3, n, n)`` field, mm.

        Returns:
            ``(m, 3)`` displacement, mm, and ``(m, 2, 2)`` derivatives d(u_x, u_y) / d(x, y).
        """
        moved, *slopes = (self._matrix @ displacement_mm.reshape(3, -1).T).reshape(3, -1, 3)
        return moved, np.stack(slopes, axis=-1)[:, :2]


def _lagrange(fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights (and their slopes) of the stencil at fractions of a cell."""
    values = np.ones((*fraction.shape, len(_STENCIL)))
    slopes = np.zeros_like(values)
    for i, node in enumerate(_STENCIL):
        for other in _STENCIL[node != _STENCIL]:
            factor = (fraction - other) / (node - other)
            slopes[..., i] = slopes[..., i] * factor + values[..., i] / (node - other)
            values[..., i] *= factor
    return values, slopes
