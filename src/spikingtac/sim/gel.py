"""The gel: displacement of the markers under an indenter's motion, with friction and creep.

A linear gel whose surface sticks to a body shows no creep, because its modulus cancels. Creep
appears as a residual displacement after unloading. The creep chain therefore takes the traction as
its input, not the displacement: u = J0 G q + sum w_i, tau_i dw_i/dt = J_i G q - w_i.

The model is a layer of shear modulus mu and thickness h, bonded to the window of the camera. The
markers move with its free surface (the black skin is part of the layer).
"""

from dataclasses import dataclass, field

import numpy as np

from spikingtac.schema import require_within
from spikingtac.sim.gel_contact import GelContact
from spikingtac.sim.indenters import Indenter
from spikingtac.sim.layer import GridConfig, LayerOperator, MarkerInterpolation
from spikingtac.sim.optics import SkinState
from spikingtac.types import KPA_PER_MPA, US_PER_S, FloatArray, Pose

# Retarded compliances J_i / J0 of the gel (a Kelvin chain) and their retardation times tau_i, s
# (contract.md). They are a declared fit: no spectrum of the paper's gel is published.
CREEP_FRACTIONS, CREEP_TIMES_S = np.array([0.05, 0.05, 0.12]), np.array([0.02, 0.3, 8.0])


# Stored creep below this is set to zero (1.6e-4 px, a thousandth of any tracker's error).
NEGLIGIBLE_CREEP_MM = 1e-5


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
        contact: With the body that touches; its ``friction`` may be set while none does.
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
        grid, layer = config.grid, LayerOperator(config.grid, config.thickness_mm)
        self._grid, self._compliance = grid, KPA_PER_MPA / config.shear_modulus_kpa
        self.contact = GelContact(grid, layer, config.friction)
        self._markers = MarkerInterpolation(grid, marker_rest_mm)
        self._rest = np.column_stack((marker_rest_mm, np.zeros(len(marker_rest_mm))))
        self.reset()

    def reset(self) -> None:
        """Return to a gel at rest without any history, at time zero."""
        cells = self._grid.cells
        self._t_s, self.resting = 0.0, True
        self.displacement_mm = np.zeros((3, cells, cells))
        self._retarded_mm = np.zeros((len(CREEP_TIMES_S), 3, cells, cells))  # of each element
        self.contact.release()

    @property
    def pressure_mpa(self) -> FloatArray:
        """``(n, n)`` contact pressure on the cells, N/mm²."""
        return self.contact.traction[2]

    @property
    def in_contact(self) -> bool:
        """True where any pressure acts."""
        return bool(self.pressure_mpa.any())

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
        touch = None
        if indenter is not None and pose is not None and pose.position_mm[2] > lowest_mm:
            touch = indenter, pose
        if touch or not self.resting:
            self._advance(dt_s, touch)
        return self._state(pose)

    def _advance(self, dt_s: float, touch: tuple[Indenter, Pose] | None) -> None:
        """Solve the contact, if a body may touch, and let the gel creep.

        The creep chain is exact for a traction that is constant in the step.
        """
        decay = np.exp(-dt_s / CREEP_TIMES_S)[:, None, None, None]
        retarded_mm = decay * self._retarded_mm
        history_mm, moved = retarded_mm.sum(axis=0), None
        softening = 1.0 + float(CREEP_FRACTIONS @ -np.expm1(-dt_s / CREEP_TIMES_S))
        compliance = self._compliance * softening
        if touch is None:
            self.contact.release()
        else:
            moved = self.contact.press(*touch, history_mm, self.displacement_mm, compliance)
        self.displacement_mm, self._retarded_mm = history_mm, retarded_mm
        if moved is not None:
            self.resting, self.displacement_mm = False, compliance * moved + history_mm
            shares = (1.0 - decay) * CREEP_FRACTIONS[:, None, None, None]
            retarded_mm += shares * (self._compliance * moved)
        elif np.abs(retarded_mm).max(axis=(1, 2, 3)).sum() < NEGLIGIBLE_CREEP_MM:
            self.resting, retarded_mm[:], history_mm[:] = True, 0.0, 0.0

    def _state(self, pose: Pose | None) -> SkinState:
        moved, gradient = self._markers.at_markers(self.displacement_mm)
        force, torque = np.zeros(3), np.zeros(3)
        if self.in_contact:
            grid, cells = self._grid, self.contact.cells
            forces = self.contact.traction.reshape(3, -1)[:, cells] * grid.pitch_mm**2
            place = self.displacement_mm.reshape(3, -1)[:, cells].copy()
            rows, columns = np.divmod(cells, grid.cells)
            place[0] += grid.axis_mm[columns]
            place[1] += grid.axis_mm[rows]
            x, y, z = place @ forces.T  # sums of place times force, components by components
            force = forces.sum(axis=1)
            torque = np.array([y[2] - z[1], z[0] - x[2], x[1] - y[0]])
        touching, sticking = self.contact.patch
        return SkinState(
            t_us=round(self._t_s * US_PER_S),
            marker_mm=self._rest + moved,
            gradient=gradient + np.eye(2),
            force_n=force,
            torque_n_mm=torque,
            pose_mm=np.full(3, np.nan) if pose is None else pose.position_mm.copy(),
            in_contact=self.in_contact,
            touching_cells=touching,
            sticking_cells=sticking,
        )
