"""One body against one gel: which cells touch, press, stick and slip, step by step.

The grid is attached to the skin: a cell is a piece of material, met by the body where it has been
carried to. So a body that drags or turns a stuck patch stays on the same cells, however far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import SpikingTacError
from spikingtac.sim.friction import shear_kernel
from spikingtac.sim.greens import GridConfig, LayerOperator
from spikingtac.sim.indenters import Indenter
from spikingtac.sim.influence import Influence, product_kernel, sheared_kernel
from spikingtac.sim.normal_contact import pressure_kernel
from spikingtac.types import Pose

Field = NDArray[np.float64]

KPA_PER_MPA = 1e3
"""Moduli are configured in kPa; tractions are in N/mm², which is MPa."""

NEAR_PITCHES = 0.05
"""Cells closer to the body than this share of a cell's side must be among those solved for."""
MOST_CELLS = 2500
"""Most cells in one contact: six dense matrices of that size take 300 MB."""
MOST_ITERATIONS = 400
"""Where the conjugate gradients stop; a cold start takes about 10, a warm one about 5."""
MOST_SWEEPS = 400
"""Where the friction sweeps stop; a cold start takes about 20, a warm one about 6."""
EXTENSIONS = 4
"""Times the set may grow within a step, where the gel bulges into the body beyond it."""
ON_RIM = 1.0 - 1e-6
"""Share of the friction bound from which a cell counts as slipping (rounding only)."""


@dataclass(frozen=True, kw_only=True)
class FrictionConfig:
    """Dry friction between skin and body.

    Attributes:
        static: Coefficient of friction while a cell sticks (contract: 0.8).
        kinetic_ratio: Coefficient while it slips, over the static one (0.8 for dry silicone).
        tolerance_mm: Error of displacement at which the iterations end (ours: 1e-4 mm, 0.002 px).
    """

    static: float = 0.8
    kinetic_ratio: float = 0.8
    tolerance_mm: float = 1e-4

    def __post_init__(self) -> None:
        if self.static < 0 or not 0 < self.kinetic_ratio <= 1 or not self.tolerance_mm > 0:
            raise ValueError("static must be >= 0, kinetic_ratio in (0, 1], tolerance_mm > 0")


class Touch:
    """State of the contact between the gel and whatever touches it.

    Attributes:
        traction: ``(3, n, n)`` shear along x and y, and pressure, N/mm².
        sticking: ``(n, n)`` True where the skin is attached to the body.
    """

    def __init__(self, grid: GridConfig, layer: LayerOperator, friction: FrictionConfig) -> None:
        n = grid.cells
        self._grid, self._layer, self._friction = grid, layer, friction
        self._rest = np.stack(np.meshgrid(grid.axis_mm, grid.axis_mm)).reshape(2, -1)
        self.traction = np.zeros((3, n, n))
        self.sticking = np.zeros((n, n), np.bool_)
        self._influence = Influence(layer.tables)
        self._key: tuple[int, float] | None = None
        self._indenter: Indenter | None = None
        self.release()

    def release(self) -> None:
        """Forget the contact: nothing touches."""
        cells = self._rest.shape[1]
        self.traction[:] = 0.0
        self.sticking[:] = False
        self._change = np.zeros((3, cells))
        self._slipping = np.zeros(cells, np.bool_)
        self._body = np.zeros((cells, 3))
        self._bound = np.empty(0, np.float32)
        self._spread = np.empty((2, 0), np.float32)
        self._relative: Field | None = None

    @property
    def cells(self) -> NDArray[np.int64]:
        """Flat indices of the cells outside of which no traction acts."""
        return self._influence.cells

    def press(
        self, indenter: Indenter, pose: Pose, history: Field, before: Field, compliance: float
    ) -> Field | None:
        """Solve one step and return the new displacement at unit compliance, or None if clear.

        Args:
            indenter: The body.
            pose: Where it is at the end of the step.
            history: ``(3, n, n)`` displacement left by former tractions at the end of the step, mm.
            before: ``(3, n, n)`` displacement at the end of the last step, mm.
            compliance: What a traction meets over the step, mm²/N.

        Returns:
            ``(3, n, n)`` displacement of the new traction at unit compliance, N/mm.
        """
        if indenter is not self._indenter:
            self.release()
            self._indenter = indenter
        center = pose.position_mm + np.array([0.0, 0.0, indenter.center_mm(pose.rotation)])
        relative = self._carried(center, pose.rotation, before)
        reach = self._reach(indenter, pose, relative)
        near = NEAR_PITCHES * self._grid.pitch_mm
        needed = (before[2].ravel() - reach < near) | (self.traction[2].ravel() > 0.0)
        if not needed.any():
            self.release()
            return None
        self._renew(needed, compliance)
        moved = self._settle(relative, reach, history, compliance)
        displacement = (compliance * moved + history)[:2].reshape(2, -1)
        self._attach(displacement, reach, center, pose.rotation, history.reshape(3, -1))
        return moved

    def _settle(self, relative: Field, reach: Field, history: Field, compliance: float) -> Field:
        """Solve, and again with more cells where the gel has bulged into the body."""
        near = NEAR_PITCHES * self._grid.pitch_mm
        for _ in range(EXTENSIONS):
            self._solve(relative, reach, history.reshape(3, -1))
            moved = self._layer.displacements(self.traction)
            beyond = reach - (compliance * moved[2] + history[2]).ravel() > near
            beyond[self._influence.cells] = False
            if not beyond.any():
                return moved
            beyond[self._influence.cells] = True
            self._renew(beyond, compliance)
        self._solve(relative, reach, history.reshape(3, -1))
        return self._layer.displacements(self.traction)

    def _carried(self, center: Field, rotation: Field, before: Field) -> Field:
        """Return each cell's displacement against the body's undeformed shape, if it sticks."""
        last = self._relative
        relative = before[:2].reshape(2, -1).copy() if last is None else last.copy()
        held = np.flatnonzero(self.sticking)
        relative[:, held] = (center + self._body[held] @ rotation.T)[:, :2].T - self._rest[:, held]
        return relative

    def _reach(self, indenter: Indenter, pose: Pose, relative: Field) -> Field:
        """Return how deep the body's undeformed surface stands at each cell, mm."""
        x, y = self._rest + relative - pose.position_mm[:2, None]
        return pose.position_mm[2] + indenter.heights_mm(x, y, pose.rotation)

    def _renew(self, chosen: NDArray[np.bool_], compliance: float) -> None:
        """Make the influence matrices fit the cells, the step's compliance and the body."""
        if chosen.sum() > MOST_CELLS:
            raise SpikingTacError(
                f"the contact covers {chosen.sum()} cells, the most is {MOST_CELLS}; press "
                "less deeply, take a smaller indenter or a coarser grid"
            )
        key = id(self._indenter), compliance
        if key != self._key:
            self._key, self._influence = key, Influence(self._tables(compliance))
        self._influence.choose(chosen)

    def _tables(self, compliance: float) -> Field:
        tables = compliance * self._layer.tables
        soft = self._indenter.soft if self._indenter is not None else None
        if soft is None:
            return tables
        body = LayerOperator(self._grid, soft.thickness_mm).tables
        # The body faces the gel: what pressure does to it sideways counts the other way.
        facing = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])[:, None, None]
        return tables + facing * body * KPA_PER_MPA / soft.shear_modulus_kpa

    def _solve(self, relative: Field, reach: Field, history: Field) -> None:
        cells, tolerance = self._influence.cells, self._friction.tolerance_mm
        xx, xy, yy, zz, xz, yz = self._influence.matrices
        flat = self.traction.reshape(3, -1)
        last = flat[:, cells]
        guess = np.ascontiguousarray(last + self._change[:, cells], np.float32)
        guess[2, last[2] == 0.0] = 0.0
        lifted = (reach[cells] - history[2, cells]).astype(np.float32)
        lifted += product_kernel(xz, guess[0]) + product_kernel(yz, guess[1])
        shear, pressure = guess[:2].copy(), guess[2].copy()
        pressure_kernel(zz, lifted, pressure, tolerance, MOST_ITERATIONS)
        target = np.ascontiguousarray(relative[:, cells] - history[:2, cells], np.float32)
        spread = np.stack((product_kernel(xz, pressure), product_kernel(yz, pressure)))
        target -= spread
        coefficient = np.where(self._slipping[cells], self._friction.kinetic_ratio, 1.0)
        bound = (self._friction.static * coefficient * pressure).astype(np.float32)
        shear_kernel(xx, xy, yy, target, bound, shear, tolerance, MOST_SWEEPS)
        self._bound, self._spread = bound, spread
        self._change[:] = 0.0
        flat[:] = 0.0
        flat[:2, cells], flat[2, cells] = shear, pressure
        self._change[:, cells] = flat[:, cells] - last

    def _attach(
        self, relative: Field, reach: Field, center: Field, rotation: Field, history: Field
    ) -> None:
        """Remember where on the body each touching cell now is."""
        cells = self._influence.cells
        tau_x, tau_y, pressure = self.traction.reshape(3, -1)[:, cells]
        touching = pressure > 0.0
        slipping = touching & (np.hypot(tau_x, tau_y) >= ON_RIM * self._bound)
        held = self.sticking.ravel()
        fresh = touching & (slipping | ~held[cells])
        if self._indenter is not None and self._indenter.soft is not None:
            relative[:, cells] = self._against_soft() + history[:2, cells]
        new = cells[fresh]
        place = np.vstack((self._rest[:, new] + relative[:, new], reach[new])).T
        self._body[new] = (place - center) @ rotation
        held[:] = False
        held[cells[touching]] = True
        self._slipping[:] = False
        self._slipping[cells[slipping]] = True
        self._relative = relative

    def _against_soft(self) -> Field:
        """Return what the tractions do to the cells, gel and body together, ``(2, c)``, mm."""
        shear = self.traction.reshape(3, -1)[:2, self._influence.cells]
        xx, xy, yy = self._influence.matrices[:3]
        sheared = sheared_kernel(xx, xy, yy, np.ascontiguousarray(shear, np.float32))
        return (sheared + self._spread).astype(np.float64)
