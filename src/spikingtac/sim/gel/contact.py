"""One body against one gel: which cells touch, press, stick and slip, step by step.

The grid is attached to the skin: a cell is a piece of material, met by the body where it has been
carried to. So a body that drags or turns a stuck patch stays on the same cells, however far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import SpikingTacError
from spikingtac.sim.gel.friction import shear_kernel
from spikingtac.sim.gel.greens import GridConfig, LayerOperator
from spikingtac.sim.gel.grid_cells import (
    attach_kernel,
    carry_kernel,
    collect_kernel,
    deposit_kernel,
)
from spikingtac.sim.gel.indenters import Indenter, SoftLayer
from spikingtac.sim.gel.influence import Influence, product_kernel, sheared_kernel
from spikingtac.sim.gel.normal_contact import pressure_kernel
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
        self._key: tuple[SoftLayer | None, float] | None = None
        self._indenter: Indenter | None = None
        self._clear = False
        self.release()

    def release(self) -> None:
        """Forget the contact: nothing touches."""
        if self._clear:
            return
        self._clear = True
        cells = self._rest.shape[1]
        self.traction[:] = 0.0
        self.sticking[:] = False
        self._change = np.zeros((3, cells))
        self._slipping = np.zeros(cells, np.bool_)
        self._body = np.zeros((cells, 3))
        self._pose = np.zeros((3, 4))
        self._bound = np.empty(0, np.float32)
        self._spread = np.empty((2, 0), np.float32)
        self._relative: Field | None = None
        # The order of slots decides the last digits: a new contact starts without a past.
        self._influence.clear()

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
        self._indenter, self._clear = indenter, False
        center = pose.position_mm + np.array([0.0, 0.0, indenter.center_mm(pose.rotation)])
        asked = self._asked(indenter, pose, center, before)
        near = NEAR_PITCHES * self._grid.pitch_mm
        needed = before[2].ravel() - asked[2] < near
        needed[self._influence.cells] |= self.traction[2].ravel()[self._influence.cells] > 0.0
        if not needed.any():
            self.release()
            return None
        self._renew(needed, compliance)
        flat = history.reshape(3, -1)
        moved = self._settle(asked, flat, compliance)
        self._attach(compliance * moved.reshape(3, -1)[:2] + flat[:2], asked, flat)
        return moved

    def _asked(self, indenter: Indenter, pose: Pose, center: Field, before: Field) -> Field:
        """Return each cell's displacement if it sticks (x, y) or is pressed (z), ``(3, n²)``."""
        self._pose = np.column_stack((pose.rotation, center))
        asked = before.reshape(3, -1).copy()
        if self._relative is not None:
            asked[:2] = self._relative
        held = self.sticking.reshape(-1)
        carry_kernel(held, self._body, pose.rotation, center, self._rest, asked)
        x, y = self._rest + asked[:2] - pose.position_mm[:2, None]
        asked[2] = pose.position_mm[2] + indenter.heights_mm(x, y, pose.rotation)
        return asked

    def _settle(self, asked: Field, history: Field, compliance: float) -> Field:
        """Solve, and again with more cells where the gel has bulged into the body."""
        near = NEAR_PITCHES * self._grid.pitch_mm
        for _ in range(EXTENSIONS):
            self._solve(asked, history)
            moved = self._layer.displacements(self.traction)
            beyond = asked[2] - history[2] - compliance * moved[2].ravel() > near
            beyond[self._influence.cells] = False
            if not beyond.any():
                return moved
            beyond[self._influence.cells] = True
            self._renew(beyond, compliance)
        self._solve(asked, history)
        return self._layer.displacements(self.traction)

    def _renew(self, chosen: NDArray[np.bool_], compliance: float) -> None:
        """Make the influence matrices fit the cells, the step's compliance and the body."""
        if chosen.sum() > MOST_CELLS:
            raise SpikingTacError(
                f"the contact covers {chosen.sum()} cells, the most is {MOST_CELLS}; press "
                "less deeply, take a smaller indenter or a coarser grid"
            )
        key = None if self._indenter is None else self._indenter.soft, compliance
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

    def _solve(self, asked: Field, history: Field) -> None:
        cells, friction = self._influence.cells, self._friction
        xx, xy, yy, zz, xz, yz = self._influence.matrices
        flat = self.traction.reshape(3, -1)
        guess, target = np.empty((2, 3, len(cells)), np.float32)
        collect_kernel(cells, flat, self._change, asked, history, guess, target)
        shear, pressure = guess[:2], guess[2]
        target[2] += product_kernel(xz, shear[0]) + product_kernel(yz, shear[1])
        pressure_kernel(zz, target[2], pressure, friction.tolerance_mm, MOST_ITERATIONS)
        spread = np.stack((product_kernel(xz, pressure), product_kernel(yz, pressure)))
        target[:2] -= spread
        coefficient = np.where(self._slipping[cells], friction.kinetic_ratio, 1.0)
        bound = (friction.static * coefficient * pressure).astype(np.float32)
        shear_kernel(xx, xy, yy, target[:2], bound, shear, friction.tolerance_mm, MOST_SWEEPS)
        self._bound, self._spread = bound, spread
        deposit_kernel(cells, shear, pressure, flat, self._change)

    def _attach(self, relative: Field, asked: Field, history: Field) -> None:
        """Remember where on the body each touching cell now is."""
        cells = self._influence.cells
        tau_x, tau_y, pressure = self.traction.reshape(3, -1)[:, cells]
        touching = pressure > 0.0
        slipping = touching & (np.hypot(tau_x, tau_y) >= ON_RIM * self._bound)
        held = self.sticking.reshape(-1)
        fresh = cells[touching & (slipping | ~held[cells])]
        if self._indenter is not None and self._indenter.soft is not None:
            relative[:, cells] = self._against_soft() + history[:2, cells]
        attach_kernel(fresh, self._rest, relative, asked[2], self._pose, self._body)
        held[:] = False
        held[cells] = touching
        self._slipping[:] = False
        self._slipping[cells] = slipping
        self._relative = relative

    def _against_soft(self) -> Field:
        """Return what the tractions do to the cells, gel and body together, ``(2, c)``, mm."""
        shear = self.traction.reshape(3, -1)[:2, self._influence.cells]
        xx, xy, yy = self._influence.matrices[:3]
        sheared = sheared_kernel(xx, xy, yy, np.ascontiguousarray(shear, np.float32))
        return (sheared + self._spread).astype(np.float64)
