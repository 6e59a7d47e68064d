"""Motion of the markers of a gel pad with the probe that it holds.

The pad is the bonded incompressible layer of the gel. The grasped probe sticks to a rectangular
patch of it. A patch that moves rigidly has six degrees of freedom, so that six unit responses
describe the skin: rigid inside the patch, decaying outside according to the layer. The layer is
linear, homogeneous and sticking, so that the responses depend neither on the modulus nor on creep.

Frame: the pad's image (x right, y down and along the probe, z towards the camera), origin at the
centre of the patch. Modes: translation along x, y, z; rotation in the plane, ``(-y, x, 0)``; and
the two tilts, ``(0, 0, x)`` and ``(0, 0, y)``.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from spikingtac.arrays import FloatArray
from spikingtac.sim.gel.layer import GridConfig, LayerOperator

MODES = 6
GRID = GridConfig(cells=128, span_mm=51.2)
"""Cells of 0.4 mm (twin.md, section 2), with the periodic images 8 layer depths away."""
RELATIVE_TOLERANCE = 1e-5
"""Tolerance of the conjugate gradients: 0.0003 px for the largest motion."""


@dataclass(frozen=True, kw_only=True)
class PatchConfig:
    """The patch of a pad that sticks to the probe.

    Attributes:
        width_mm: Extent across the probe, mm (twin.md: effective patch 7 x 18 mm).
        length_mm: Extent along the probe, mm.
        thickness_mm: Depth of the gel layer, mm (contract.md: 3 mm).
    """

    width_mm: float = 7.0
    length_mm: float = 18.0
    thickness_mm: float = 3.0


@dataclass(frozen=True)
class PadResponse:
    """Unit responses of the markers, and the patch's own stiffness.

    Attributes:
        displacement: ``(6, m, 3)`` displacement of each marker per unit of each mode.
        gradient: ``(6, m, 2, 2)`` d(displacement xy) / d(rest xy) per unit of each mode.
        stiffness: ``(6,)`` diagonal stiffness of one pad for a shear modulus of 1 N/mm2: N/mm for
            the translations, N mm/rad for the rotations.
    """

    displacement: FloatArray
    gradient: FloatArray
    stiffness: FloatArray


def rigid_modes(points_mm: FloatArray) -> FloatArray:
    """Return the six rigid displacement fields ``(6, n, 3)`` at points ``(n, 2)``."""
    x, y = points_mm.T
    modes = np.zeros((MODES, len(points_mm), 3))
    modes[0, :, 0] = modes[1, :, 1] = modes[2, :, 2] = 1.0
    modes[3, :, 0], modes[3, :, 1] = -y, x
    modes[4, :, 2], modes[5, :, 2] = x, y
    return modes


def pad_response(config: PatchConfig, marker_mm: FloatArray) -> PadResponse:
    """Solve the six unit responses at the markers.

    Args:
        config: The patch and the layer.
        marker_mm: ``(m, 2)`` rest positions of the markers in the pad's frame, mm.
    """
    points = tuple(map(tuple, np.asarray(marker_mm, np.float64)[:, :2].tolist()))
    return _pad_response(config, points)


@functools.lru_cache(maxsize=16)
def _pad_response(config: PatchConfig, points: tuple[tuple[float, float], ...]) -> PadResponse:
    solver = _PatchSolver(config)
    marker = np.array(points)
    tractions = [solver.traction(mode) for mode in rigid_modes(solver.cells_mm)]
    fields = [solver.evaluate(traction, marker) for traction in tractions]
    displacement, gradient = (np.stack(parts) for parts in zip(*fields, strict=True))
    inside = (np.abs(marker) <= [config.width_mm / 2, config.length_mm / 2]).all(axis=1)
    displacement[:, inside] = rigid_modes(marker[inside])
    gradient[:, inside] = 0.0
    gradient[3, inside] = [[0.0, -1.0], [1.0, 0.0]]
    modes = rigid_modes(solver.cells_mm)
    stiffness = np.array(
        [(mode * t).sum() * GRID.pitch_mm**2 for mode, t in zip(modes, tractions, strict=True)]
    )
    return PadResponse(displacement, gradient, stiffness)


class _PatchSolver:
    """Traction on the patch's cells that gives a prescribed displacement there."""

    def __init__(self, config: PatchConfig) -> None:
        self._axis = GRID.axis_mm
        half = np.array([config.length_mm, config.width_mm]) / 2.0
        rows, columns = (np.flatnonzero(np.abs(self._axis) <= side) for side in half)
        self._inside = np.ix_(np.arange(3), rows, columns)
        x, y = np.meshgrid(self._axis[columns], self._axis[rows])
        self.cells_mm: FloatArray = np.stack([x.ravel(), y.ravel()], axis=1)
        self._layer = LayerOperator(GRID, config.thickness_mm)

    def _displacement(self, traction: FloatArray) -> FloatArray:
        grid = np.zeros((3, GRID.cells, GRID.cells))
        shape = grid[self._inside].shape
        grid[self._inside] = traction.T.reshape(shape)
        return self._layer.displacements(grid)

    def traction(self, displacement: FloatArray) -> FloatArray:
        """Return the traction ``(n, 3)`` for a displacement ``(n, 3)`` of the patch's cells."""
        size, shape = displacement.size, displacement.shape

        def apply(flat: FloatArray) -> FloatArray:
            return self._displacement(flat.reshape(shape))[self._inside].reshape(3, -1).T.ravel()

        operator = LinearOperator((size, size), matvec=apply, dtype=np.float64)  # type: ignore[call-arg]
        flat, failed = cg(operator, displacement.ravel(), rtol=RELATIVE_TOLERANCE, maxiter=500)
        if failed:
            raise RuntimeError("the pad's unit response did not converge in 500 steps")
        return flat.reshape(shape)

    def evaluate(
        self, traction: FloatArray, points_mm: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return displacement ``(m, 3)`` and its gradient ``(m, 2, 2)`` at points.

        The field is band-limited, so its Fourier series is exact between the cells too.
        """
        spectrum = np.fft.fft2(self._displacement(traction)) / GRID.cells**2
        k = 2.0 * np.pi * np.fft.fftfreq(GRID.cells, GRID.pitch_mm)
        along_x, along_y = (np.exp(1j * (c[:, None] - self._axis[0]) * k) for c in points_mm.T)

        def at_points(field: NDArray[np.complex128]) -> FloatArray:
            return np.einsum("my,iyx,mx->mi", along_y, field, along_x, optimize=True).real

        by_x = at_points(1j * k * spectrum[:2])
        by_y = at_points(1j * k[:, None] * spectrum[:2])
        return at_points(spectrum), np.stack([by_x, by_y], axis=-1)
