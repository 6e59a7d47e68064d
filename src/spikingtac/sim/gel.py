"""The gel: displacement of the markers under an indenter's motion, with friction and creep.

A linear gel whose surface sticks to a body shows no creep, because its modulus cancels. Creep
appears as a residual displacement after unloading. The creep chain therefore takes the traction as
its input, not the displacement: u = J0 G q + sum w_i, tau_i dw_i/dt = J_i G q - w_i.

The model is a layer of shear modulus mu and thickness h, bonded to the window of the camera. The
markers move with its free surface (the black skin is part of the layer).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from spikingtac.arrays import FloatArray
from spikingtac.schema import require_within
from spikingtac.sim.gel_contact import KPA_PER_MPA, GelContact
from spikingtac.sim.indenters import Indenter
from spikingtac.sim.layer import GridConfig, LayerOperator, MarkerInterpolation
from spikingtac.sim.optics import ContactPatch, SkinState
from spikingtac.types import Pose

# Retarded compliances J_i / J0 of the gel (a Kelvin chain) and their retardation times tau_i, s
# (contract.md). They are a declared fit: no spectrum of the paper's gel is published.
CREEP_FRACTIONS, CREEP_TIMES_S = np.array([0.05, 0.05, 0.12]), np.array([0.02, 0.3, 8.0])


class CreepChain:
    """Retarded displacement fields. A step is exact if the traction is constant in it.

    All displacements are given per instantaneous compliance: ``elastic`` is J0 G q.

    Args:
        shape: Shape of a displacement field.

    Attributes:
        retarded: ``(k, *shape)`` displacements stored by each element, mm.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.retarded = np.zeros((len(CREEP_TIMES_S), *shape))

    def compliance(self, dt_s: float) -> float:
        """Return the compliance over the coming step, divided by J0."""
        return 1.0 + float(CREEP_FRACTIONS @ -np.expm1(-dt_s / CREEP_TIMES_S))

    def history(self, dt_s: float) -> FloatArray:
        """Return the displacement that former tractions leave at the end of the coming step, mm."""
        out = np.zeros(self.retarded.shape[1:])
        for decay, retarded in zip(np.exp(-dt_s / CREEP_TIMES_S), self.retarded, strict=True):
            out += decay * retarded
        return out

    def advance(self, dt_s: float, elastic: FloatArray | None) -> None:
        """Advance by one step under a constant traction.

        Args:
            dt_s: Length of the step, s.
            elastic: Instantaneous displacement under that traction, mm; None if the traction is
                zero.
        """
        for i, decay in enumerate(np.exp(-dt_s / CREEP_TIMES_S)):
            self.retarded[i] *= decay
            if elastic is not None:
                self.retarded[i] += (1.0 - decay) * CREEP_FRACTIONS[i] * elastic


# Stored creep below this is set to zero (1.6e-4 px, a thousandth of any tracker's error).
NEGLIGIBLE_CREEP_MM = 1e-5
US_PER_S = 1e6


@dataclass(frozen=True, kw_only=True)
class GelConfig:
    """The gel. The default values are pinned in the contract.

    Attributes:
        shear_modulus_kpa: Instantaneous shear modulus mu, kPa (tactile gels: 20 to 60).
        thickness_mm: Thickness h of gel and skin together, mm.
        friction: Coefficient of friction between skin and indenter while a cell sticks.
        grid: Cells of the mechanics.
    """

    shear_modulus_kpa: float = 30.0
    thickness_mm: float = 3.0
    friction: float = 0.8
    grid: GridConfig = field(default_factory=GridConfig)

    def __post_init__(self) -> None:
        require_within(self, shear_modulus_kpa=(0.1, 1e5), thickness_mm=(0.1, 50.0))
        require_within(self, friction=(0.0, 100.0))


class Gel:
    """A gel with markers, stepped in time.

    Attributes:
        displacement_mm: ``(3, n, n)`` displacement of the cells along x, y and towards the camera.
        resting: True while nothing touches and the stored creep is negligible.

    Example:
        >>> gel = Gel(GelConfig(), np.zeros((1, 2)))
        >>> gel.step(0.004, None, None).in_contact
        False
    """

    def __init__(self, config: GelConfig, marker_rest_mm: FloatArray) -> None:
        """Build the gel at rest.

        Args:
            config: Properties of the gel.
            marker_rest_mm: ``(m, 2)`` markers at rest (x right, y down), mm.
        """
        grid = config.grid
        self._config = config
        self._compliance = KPA_PER_MPA / config.shear_modulus_kpa
        self._layer = LayerOperator(grid, config.thickness_mm)
        self._contact = GelContact(grid, self._layer, config.friction)
        self._creep = CreepChain((3, grid.cells, grid.cells))
        self._markers = MarkerInterpolation(grid, marker_rest_mm)
        self._rest = np.column_stack((marker_rest_mm, np.zeros(len(marker_rest_mm))))
        self.displacement_mm = np.zeros((3, grid.cells, grid.cells))
        self.reset()

    def reset(self) -> None:
        """Return to a gel at rest without any history, at time zero."""
        self._t_s = 0.0
        self.resting = True
        self.displacement_mm[:] = 0.0
        self._contact.release()
        self._creep.retarded[:] = 0.0

    @property
    def pressure_mpa(self) -> FloatArray:
        """``(n, n)`` contact pressure on the cells, N/mm²."""
        return self._contact.traction[2]

    @property
    def in_contact(self) -> bool:
        """True where any pressure acts."""
        return bool(self._contact.traction[2].any())

    @property
    def patch(self) -> ContactPatch:
        """Which cells of the skin are touched, and which of these stick."""
        return self._contact.patch

    def step(self, dt_s: float, indenter: Indenter | None, pose: Pose | None) -> SkinState:
        """Advance the gel and return its markers.

        Args:
            dt_s: Length of the step, s (2 to 4 ms).
            indenter: The body that may touch, or None.
            pose: Pose of that body at the end of the step, or None.

        Raises:
            SpikingTacError: The contact covers more of the grid than can be solved.
            ValueError: The step is not positive.
        """
        if not dt_s > 0:
            raise ValueError(f"dt_s is {dt_s}, it must be positive")
        self._t_s += dt_s
        lowest_mm = 0.0 if self.resting else float(self.displacement_mm[2].min())
        if indenter is None or pose is None or pose.position_mm[2] <= lowest_mm:
            self._recover(dt_s)
        else:
            self._advance(dt_s, indenter, pose)
        return self._state(pose)

    def _advance(self, dt_s: float, indenter: Indenter, pose: Pose) -> None:
        history = self._creep.history(dt_s)
        compliance = self._compliance * self._creep.compliance(dt_s)
        moved = self._contact.press(indenter, pose, history, self.displacement_mm, compliance)
        if moved is None:
            self._recover(dt_s)
            return
        self.resting = False
        self._creep.advance(dt_s, self._compliance * moved)
        self.displacement_mm = compliance * moved + history

    def _recover(self, dt_s: float) -> None:
        """Let the gel creep back while nothing touches it."""
        self._contact.release()
        if self.resting:
            return
        self.displacement_mm = self._creep.history(dt_s)
        self._creep.advance(dt_s, None)
        if sum(np.abs(part).max() for part in self._creep.retarded) < NEGLIGIBLE_CREEP_MM:
            self._creep.retarded[:] = 0.0
            self.displacement_mm[:] = 0.0
            self.resting = True

    def _state(self, pose: Pose | None) -> SkinState:
        moved, gradient = self._markers.at_markers(self.displacement_mm)
        force, torque = self._load()
        return SkinState(
            t_us=round(self._t_s * US_PER_S),
            marker_mm=self._rest + moved,
            gradient=gradient + np.eye(2),
            force_n=force,
            torque_n_mm=torque,
            pose_mm=np.full(3, np.nan) if pose is None else pose.position_mm.copy(),
            in_contact=self.in_contact,
            patch=self.patch,
        )

    def _load(self) -> tuple[FloatArray, FloatArray]:
        """Return the force (N) and the moment (N mm) of the body on the skin."""
        if not self.in_contact:
            return np.zeros(3), np.zeros(3)
        grid = self._config.grid
        cells = self._contact.cells
        force = self._contact.traction.reshape(3, -1)[:, cells] * grid.pitch_mm**2
        place = self.displacement_mm.reshape(3, -1)[:, cells].copy()
        rows, columns = np.divmod(cells, grid.cells)
        place[0] += grid.axis_mm[columns]
        place[1] += grid.axis_mm[rows]
        x, y, z = place @ force.T  # sums of place times force, components by components
        return force.sum(axis=1), np.array([y[2] - z[1], z[0] - x[2], x[1] - y[0]])
