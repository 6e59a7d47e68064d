"""A gel pad that holds the rod: motion of its markers under the motion of the rod.

The pad is the bonded incompressible layer of the gel. The grasped probe sticks to a rectangular
patch of it. A patch that moves rigidly has six degrees of freedom, so that six unit responses
describe the skin: rigid inside the patch, decaying outside according to the layer. The layer is
linear, homogeneous and sticking, so that the responses depend neither on the modulus nor on creep.

Frame: the pad's image (x right, y down and along the probe, z towards the camera), origin at the
centre of the patch. Modes: translation along x, y, z; rotation in the plane, ``(-y, x, 0)``; and
the two tilts, ``(0, 0, x)`` and ``(0, 0, y)``.
"""

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from spikingtac.sim.layer import GridConfig, LayerOperator
from spikingtac.sim.optics import SkinState
from spikingtac.sim.rig.probe import GRIPPER_IN_BASE, ProbeState
from spikingtac.sim.scene import SkinConfig
from spikingtac.types import FloatArray

MODES = 6

# Cells of 0.4 mm (twin.md, section 2), with the periodic images 8 layer depths away.
GRID = GridConfig(cells=128, span_mm=51.2)
RELATIVE_TOLERANCE = 1e-5  # Tolerance of the conjugate gradients: 0.0003 px for the largest motion.
MOST_ITERATIONS = 500  # Limit of the conjugate gradients.

# Extent across and along the probe of the patch that sticks to it, mm (twin.md, section 2).
PATCH_MM = (7.0, 18.0)
THICKNESS_MM = 3.0  # Depth of the gel layer, mm (contract.md).
GRIP_MM = 0.3  # Depth by which the grip presses the rod into the pad, mm (10 % of the layer).
GRIP = np.array([0.0, 0.0, GRIP_MM, 0.0, 0.0, 0.0])  # Amplitudes of the modes under the grip.
PADS = 2  # Number of pads that share the load of the rod, with or without a camera.

# Amplitudes of the pad's modes per bushing motion (gripper frame). The pad sees the gripper's x and
# y as its own and z reversed. A rotation of the rod also moves its surface, which lies 2 mm from
# its axis (a 4 mm rod).
FROM_BUSHING = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, -2.0, 0.0],
        [0.0, 1.0, 0.0, 2.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
    ]
)
FROM_BASE = FROM_BUSHING[:3, :3] @ GRIPPER_IN_BASE.T  # The pad's axes as rows, base frame.


def rigid_modes(points_mm: FloatArray) -> FloatArray:
    """Return the six rigid displacement fields ``(6, n, 3)`` at points ``(n, 2)``."""
    x, y = points_mm.T
    modes = np.zeros((MODES, len(points_mm), 3))
    modes[0, :, 0] = modes[1, :, 1] = modes[2, :, 2] = 1.0
    modes[3, :, 0], modes[3, :, 1] = -y, x
    modes[4, :, 2], modes[5, :, 2] = x, y
    return modes


def pad_response(marker_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the six unit responses at the markers.

    Args:
        marker_mm: ``(m, 2)`` rest positions of the markers in the pad's frame, mm.

    Returns:
        Displacements ``(6, m, 3)`` per unit of each mode, and their gradients ``(6, m, 2, 2)``, d
        (displacement xy) / d(rest xy).
    """
    axis, layer = GRID.axis_mm, LayerOperator(GRID, THICKNESS_MM)
    columns, rows = (np.flatnonzero(np.abs(axis) <= side / 2.0) for side in PATCH_MM)
    patch = np.ix_(np.arange(3), rows, columns)
    x, y = np.meshgrid(axis[columns], axis[rows])
    cells_mm = np.stack([x.ravel(), y.ravel()], axis=1)

    def displacement(flat: FloatArray) -> FloatArray:
        """Return the field ``(3, n, n)`` under a traction of the patch's cells."""
        grid = np.zeros((3, GRID.cells, GRID.cells))
        grid[patch] = flat.reshape(-1, 3).T.reshape(3, len(rows), len(columns))
        return layer.displacements(grid)

    def apply(flat: FloatArray) -> FloatArray:
        return displacement(flat)[patch].reshape(3, -1).T.ravel()

    shape = (3 * len(cells_mm), 3 * len(cells_mm))
    operator = LinearOperator(shape, matvec=apply, dtype=np.float64)  # type: ignore[call-arg]
    fields = []
    limits = {"rtol": RELATIVE_TOLERANCE, "maxiter": MOST_ITERATIONS}
    for mode in rigid_modes(cells_mm):
        traction, failed = cg(operator, mode.ravel(), **limits)
        if failed:
            raise RuntimeError(f"the pad's response did not converge in {MOST_ITERATIONS} steps")
        fields.append(_at_points(displacement(traction), marker_mm))
    moved, gradient = (np.stack(parts) for parts in zip(*fields, strict=True))
    inside = (np.abs(marker_mm) <= np.array(PATCH_MM) / 2).all(axis=1)
    moved[:, inside] = rigid_modes(marker_mm[inside])
    gradient[:, inside] = 0.0
    gradient[3, inside] = [[0.0, -1.0], [1.0, 0.0]]
    return moved, gradient


def _at_points(field: FloatArray, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a field ``(3, n, n)`` and its gradient at points: ``(m, 3)`` and ``(m, 2, 2)``.

    The field is band-limited, so its Fourier series is exact between the cells too.
    """
    spectrum = np.fft.fft2(field) / GRID.cells**2
    k = 2.0 * np.pi * np.fft.fftfreq(GRID.cells, GRID.pitch_mm)
    along_x, along_y = (np.exp(1j * (c[:, None] - GRID.axis_mm[0]) * k) for c in points_mm.T)

    def summed(part: NDArray[np.complex128]) -> FloatArray:
        return np.einsum("my,iyx,mx->mi", along_y, part, along_x, optimize=True).real

    by_x, by_y = summed(1j * k * spectrum[:2]), summed(1j * k[:, None] * spectrum[:2])
    return summed(spectrum), np.stack([by_x, by_y], axis=-1)


@functools.cache
def _skin_fields() -> FloatArray:
    """Return the responses of the skin's markers, ``(6, 3 m + 4 m)``: places, then gradients."""
    moved, gradient = pad_response(SkinConfig().rest_mm())
    return np.concatenate([moved.reshape(MODES, -1), gradient.reshape(MODES, -1)], axis=1)


class Pad:
    """One pad. The patch that sticks to the rod lies in the middle of its markers."""

    def __init__(self) -> None:
        rest = SkinConfig().at_rest()
        self._rest = np.concatenate([rest.marker_mm.ravel(), rest.gradient.ravel()])
        self._coordinates = rest.marker_mm.size

    def skin(self, state: ProbeState) -> SkinState:
        """Return the skin under the rod, for a state of the probe."""
        fields = self._rest + (GRIP + FROM_BUSHING @ state.bushing) @ _skin_fields()
        places, gradient = fields[: self._coordinates], fields[self._coordinates :]
        force, lever = FROM_BASE @ state.force_n / PADS, state.tip_mm - state.center_mm
        (x, y, z), (fx, fy, fz) = (FROM_BASE @ lever).tolist(), force.tolist()
        return SkinState(
            t_us=state.t_us,
            marker_mm=places.reshape(-1, 3),
            gradient=gradient.reshape(-1, 2, 2),
            force_n=force,
            torque_n_mm=np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx]),
            pose_mm=FROM_BASE @ state.tip_mm,
            in_contact=True,
        )
