"""A gel pad that holds the rod: unit responses of its skin, and their sum under the rod's motion.

Motion of the markers of a gel pad with the probe that it holds.

The pad is the bonded incompressible layer of the gel. The grasped probe sticks to a rectangular
patch of it. A patch that moves rigidly has six degrees of freedom, so that six unit responses
describe the skin: rigid inside the patch, decaying outside according to the layer. The layer is
linear, homogeneous and sticking, so that the responses depend neither on the modulus nor on creep.

Frame: the pad's image (x right, y down and along the probe, z towards the camera), origin at the
centre of the patch. Modes: translation along x, y, z; rotation in the plane, ``(-y, x, 0)``; and
the two tilts, ``(0, 0, x)`` and ``(0, 0, y)``.

Skin of a gel pad under the motion of the rod, as a sum of the six unit responses.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from spikingtac.arrays import FloatArray
from spikingtac.sim.gel.layer import GridConfig, LayerOperator
from spikingtac.sim.rig.probe import GRIPPER_IN_BASE, ProbeState
from spikingtac.sim.scene.scene import SkinConfig
from spikingtac.sim.states import SkinState

MODES = 6

# Cells of 0.4 mm (twin.md, section 2), with the periodic images 8 layer depths away.
GRID = GridConfig(cells=128, span_mm=51.2)
RELATIVE_TOLERANCE = 1e-5  # Tolerance of the conjugate gradients: 0.0003 px for the largest motion.


# Extent across and along the probe of the patch that sticks to it, mm (twin.md, section 2).
PATCH_MM = (7.0, 18.0)
THICKNESS_MM = 3.0  # Depth of the gel layer, mm (contract.md).


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


def pad_response(marker_mm: FloatArray) -> PadResponse:
    """Solve the six unit responses at the markers.

    Args:
        marker_mm: ``(m, 2)`` rest positions of the markers in the pad's frame, mm.
    """
    points = tuple(map(tuple, np.asarray(marker_mm, np.float64)[:, :2].tolist()))
    return _pad_response(points)


@functools.lru_cache(maxsize=16)
def _pad_response(points: tuple[tuple[float, float], ...]) -> PadResponse:
    solver = _PatchSolver()
    marker = np.array(points)
    tractions = [solver.traction(mode) for mode in rigid_modes(solver.cells_mm)]
    fields = [solver.evaluate(traction, marker) for traction in tractions]
    displacement, gradient = (np.stack(parts) for parts in zip(*fields, strict=True))
    inside = (np.abs(marker) <= np.array(PATCH_MM) / 2).all(axis=1)
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

    def __init__(self) -> None:
        self._axis = GRID.axis_mm
        half = np.array(PATCH_MM[::-1]) / 2.0
        rows, columns = (np.flatnonzero(np.abs(self._axis) <= side) for side in half)
        self._inside = np.ix_(np.arange(3), rows, columns)
        x, y = np.meshgrid(self._axis[columns], self._axis[rows])
        self.cells_mm: FloatArray = np.stack([x.ravel(), y.ravel()], axis=1)
        self._layer = LayerOperator(GRID, THICKNESS_MM)

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


NORMAL_MODE = 2  # Index of the translation along the pad's z; see :mod:`spikingtac.sim.rig.pad`.


GRIP_MM = 0.3  # Depth by which the grip presses the rod into the pad, mm (ours: 10 % of the layer).
HALF_THICKNESS_MM = 2.0  # Distance from the rod's axis to the skin, mm (a 4 mm rod).
PADS = 2  # Number of pads that share the load of the rod, with or without a camera.


class Pad:
    """One pad. The patch that sticks to the rod lies in the middle of its markers.

    Args:
        faces_back: False for pad A; True for pad B, whose camera looks in the opposite direction.
    """

    def __init__(self, faces_back: bool = False) -> None:
        rest = SkinConfig().rest_mm()
        response = pad_response(rest)
        self._fields = np.concatenate(
            [response.displacement.reshape(MODES, -1), response.gradient.reshape(MODES, -1)], axis=1
        )
        self._from_bushing = mode_amplitudes(faces_back)
        self._grip = np.zeros(MODES)
        self._grip[NORMAL_MODE] = GRIP_MM
        places = np.column_stack([rest, np.zeros(len(rest))])
        undeformed = np.tile(np.eye(2), (len(rest), 1, 1))
        self._rest = np.concatenate([places.ravel(), undeformed.ravel()])
        self._coordinates = places.size

    def skin(self, state: ProbeState) -> SkinState:
        """Return the skin under the rod.

        Args:
            state: State of the probe.
        """
        amplitude = self._grip + self._from_bushing @ state.bushing
        fields = self._rest + amplitude @ self._fields
        places, gradient = fields[: self._coordinates], fields[self._coordinates :]
        axes = self._from_bushing[:3, :3] @ GRIPPER_IN_BASE.T
        force, lever = axes @ state.force_n / PADS, axes @ (state.tip_mm - state.center_mm)
        (x, y, z), (fx, fy, fz) = lever.tolist(), force.tolist()
        return SkinState(
            t_us=state.t_us,
            marker_mm=places.reshape(-1, 3),
            gradient=gradient.reshape(-1, 2, 2),
            force_n=force,
            torque_n_mm=np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx]),
            pose_mm=axes @ state.tip_mm,
            in_contact=True,
        )


def mode_amplitudes(faces_back: bool) -> FloatArray:
    """Return ``(6, 6)``: amplitudes of the pad's modes per bushing motion (gripper frame).

    Pad A sees the gripper's x and y as its own and z reversed; pad B sees x reversed. A rotation of
    the rod also moves its surface, which lies half a thickness away from its axis.
    """
    side = 1.0 if faces_back else -1.0
    out = np.zeros((MODES, MODES))
    out[0, 0], out[1, 1], out[2, 2] = -side, 1.0, side
    out[3, 5] = -side
    out[4, 4] = 1.0
    out[5, 3] = side
    out[0, 4] = -HALF_THICKNESS_MM
    out[1, 3] = -side * HALF_THICKNESS_MM
    return out
