"""Contact of one body with the gel: which cells touch, press, stick and slip in each step.

The grid is fixed to the skin, so that a cell is a piece of material. The body meets a cell at its
displaced place. A body that drags or turns a sticking patch therefore stays on the same cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.arrays import FloatArray
from spikingtac.errors import SpikingTacError
from spikingtac.schema import require_within
from spikingtac.sim.gel.indenters import Indenter, SoftLayer
from spikingtac.sim.gel.influence import Influence, lateral_displacement_kernel, product_kernel
from spikingtac.sim.gel.layer import GridConfig, LayerOperator
from spikingtac.sim.gel.solvers import pressure_kernel, shear_kernel
from spikingtac.sim.states import ContactPatch
from spikingtac.types import Pose

KPA_PER_MPA = 1e3  # Moduli are configured in kPa; tractions are in N/mm², which is MPa.

# Distance from the body, in sides of a cell, below which a cell is solved for.
NEAR_FRACTION = 0.05

# Largest number of cells in one contact: six dense matrices of that size take 300 MB.
MAX_CELLS = 2500

# Limit of the conjugate gradients; a cold start takes about 10, a warm one about 5.
MAX_ITERATIONS = 400
MAX_SWEEPS = 400  # Limit of the friction sweeps; a cold start takes about 20, a warm one about 6.

# Limit of how often the set of cells grows in one step, where the gel bulges into the body.
MAX_EXTENSIONS = 4

# Fraction of the friction bound from which a cell counts as slipping (rounding only).
SLIP_FRACTION = 1.0 - 1e-6


@dataclass(frozen=True, kw_only=True)
class FrictionConfig:
    """Dry friction between skin and body.

    Attributes:
        static: Coefficient of friction while a cell sticks (contract: 0.8).
        kinetic_ratio: Coefficient of a slipping cell divided by the static one (0.8 for dry
            silicone).
        tolerance_mm: Error of the displacement at which the iterations end (ours: 1e-4 mm, 0.002
            px).
    """

    static: float = 0.8
    kinetic_ratio: float = 0.8
    tolerance_mm: float = 1e-4

    def __post_init__(self) -> None:
        require_within(self, static=(0.0, 100.0), kinetic_ratio=(0.01, 1.0))
        require_within(self, tolerance_mm=(1e-9, 0.1))


class GelContact:
    """State of the contact between the gel and one body.

    Args:
        grid: Cells of the skin.
        layer: Elastic response of the gel.
        friction: Friction between skin and body.

    Attributes:
        traction: ``(3, n, n)`` shear along x and y, and pressure, N/mm².
        sticking: ``(n, n)`` True where the skin sticks to the body.
    """

    def __init__(self, grid: GridConfig, layer: LayerOperator, friction: FrictionConfig) -> None:
        n = grid.cells
        self._grid, self._layer, self._friction = grid, layer, friction
        self._rest = np.stack(np.meshgrid(grid.axis_mm, grid.axis_mm)).reshape(2, -1)
        self.traction = np.zeros((3, n, n))
        self.sticking = np.zeros((n, n), np.bool_)
        self._influence = Influence(layer.tables)
        self._influence_key: tuple[SoftLayer | None, float] | None = None
        self._indenter: Indenter | None = None
        self._released = False
        self.release()

    def release(self) -> None:
        """Remove the body: all tractions become zero."""
        if self._released:
            return
        self._released = True
        cells = self._rest.shape[1]
        self.traction[:] = 0.0
        self.sticking[:] = False
        self._traction_change = np.zeros((3, cells))
        self._slipping = np.zeros(cells, np.bool_)
        self._anchor_mm = np.zeros((3, cells))
        self._rotation, self._center = np.zeros((3, 3)), np.zeros(3)
        self._bound = np.empty(0, np.float32)
        self._pressure_shift = np.empty((2, 0), np.float32)
        self._relative: FloatArray | None = None
        # The order of slots changes the last digits, so a new contact starts with an empty set.
        self._influence.clear()

    @property
    def cells(self) -> NDArray[np.int64]:
        """Flat indices of the cells outside of which no traction acts."""
        return self._influence.cells

    @property
    def patch(self) -> ContactPatch:
        """Which cells touch, and which of these stick."""
        touching = self.traction[2] > 0.0
        return ContactPatch.of(touching, touching & ~self._slipping.reshape(touching.shape))

    def press(
        self,
        indenter: Indenter,
        pose: Pose,
        history: FloatArray,
        before: FloatArray,
        compliance: float,
    ) -> FloatArray | None:
        """Solve one step.

        Args:
            indenter: The body.
            pose: Pose of the body at the end of the step.
            history: ``(3, n, n)`` displacement that former tractions leave at the end of the step,
                mm.
            before: ``(3, n, n)`` displacement at the end of the last step, mm.
            compliance: Compliance of the gel over the step, mm²/N.

        Returns:
            ``(3, n, n)`` displacement of the new traction at unit compliance, N/mm, or None if
            nothing touches.

        Raises:
            SpikingTacError: The contact covers more than :data:`MAX_CELLS` cells.
        """
        if indenter is not self._indenter:
            self.release()
        self._indenter, self._released = indenter, False
        center = pose.position_mm + np.array([0.0, 0.0, indenter.center_mm(pose.rotation)])
        prescribed = self._prescribed(indenter, pose, center, before)
        near = NEAR_FRACTION * self._grid.pitch_mm
        needed = before[2].ravel() - prescribed[2] < near
        needed[self._influence.cells] |= self.traction[2].ravel()[self._influence.cells] > 0.0
        if not needed.any():
            self.release()
            return None
        self._update_influence(needed, compliance)
        flat = history.reshape(3, -1)
        moved = self._solve_with_extensions(prescribed, flat, compliance)
        self._update_anchors(compliance * moved.reshape(3, -1)[:2] + flat[:2], prescribed, flat)
        return moved

    def _prescribed(
        self, indenter: Indenter, pose: Pose, center: FloatArray, before: FloatArray
    ) -> FloatArray:
        """Return each cell's displacement if it sticks (x, y) or is pressed (z), ``(3, n²)``."""
        self._rotation, self._center = pose.rotation, center
        prescribed = before.reshape(3, -1).copy()
        if self._relative is not None:
            prescribed[:2] = self._relative
        stuck = np.flatnonzero(self.sticking)
        anchor_mm = self._anchor_mm[:, stuck]
        for axis in range(2):  # each sum in this order, so that its last digits are fixed
            carried = center[axis] + pose.rotation[axis, 0] * anchor_mm[0]
            carried = carried + pose.rotation[axis, 1] * anchor_mm[1]
            carried = carried + pose.rotation[axis, 2] * anchor_mm[2]
            prescribed[axis, stuck] = carried - self._rest[axis, stuck]
        x, y = self._rest + prescribed[:2] - pose.position_mm[:2, None]
        prescribed[2] = pose.position_mm[2] + indenter.heights_mm(x, y, pose.rotation)
        return prescribed

    def _solve_with_extensions(
        self, prescribed: FloatArray, history: FloatArray, compliance: float
    ) -> FloatArray:
        """Solve, and solve again with more cells where the gel bulges into the body."""
        near = NEAR_FRACTION * self._grid.pitch_mm
        for _ in range(MAX_EXTENSIONS):
            self._solve(prescribed, history)
            moved = self._layer.displacements(self.traction)
            beyond = prescribed[2] - history[2] - compliance * moved[2].ravel() > near
            beyond[self._influence.cells] = False
            if not beyond.any():
                return moved
            beyond[self._influence.cells] = True
            self._update_influence(beyond, compliance)
        self._solve(prescribed, history)
        return self._layer.displacements(self.traction)

    def _update_influence(self, chosen: NDArray[np.bool_], compliance: float) -> None:
        """Update the influence matrices for the cells, the compliance of the step and the body."""
        if chosen.sum() > MAX_CELLS:
            raise SpikingTacError(
                f"the contact covers {chosen.sum()} cells, the most is {MAX_CELLS}; press "
                "less deeply, take a smaller indenter or a coarser grid"
            )
        key = None if self._indenter is None else self._indenter.soft, compliance
        if key != self._influence_key:
            self._influence_key, self._influence = (
                key,
                Influence(self._influence_tables(compliance)),
            )
        self._influence.set_cells(chosen)

    def _influence_tables(self, compliance: float) -> FloatArray:
        tables = compliance * self._layer.tables
        soft = self._indenter.soft if self._indenter is not None else None
        if soft is None:
            return tables
        body = LayerOperator(self._grid, soft.thickness_mm).tables
        # The body faces the gel, so that its lateral response to pressure has the other sign.
        facing = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])[:, None, None]
        return tables + facing * body * KPA_PER_MPA / soft.shear_modulus_kpa

    def _solve(self, prescribed: FloatArray, history: FloatArray) -> None:
        cells, friction = self._influence.cells, self._friction
        xx, xy, yy, zz, xz, yz = self._influence.matrices
        flat = self.traction.reshape(3, -1)
        # The first guesses extrapolate the last step.
        guess = (flat[:, cells] + self._traction_change[:, cells]).astype(np.float32, "C")
        guess[2, flat[2, cells] == 0.0] = 0.0
        target = (prescribed[:, cells] - history[:, cells]).astype(np.float32, "C")
        shear, pressure = guess[:2], guess[2]
        target[2] += product_kernel(xz, shear[0]) + product_kernel(yz, shear[1])
        pressure_kernel(zz, target[2], pressure, friction.tolerance_mm, MAX_ITERATIONS)
        pressure_shift = np.stack((product_kernel(xz, pressure), product_kernel(yz, pressure)))
        target[:2] -= pressure_shift
        coefficient = np.where(self._slipping[cells], friction.kinetic_ratio, 1.0)
        bound = (friction.static * coefficient * pressure).astype(np.float32)
        shear_kernel(xx, xy, yy, target[:2], bound, shear, friction.tolerance_mm, MAX_SWEEPS)
        self._bound, self._pressure_shift = bound, pressure_shift
        self._traction_change[:] = 0.0
        self._traction_change[:, cells] = guess - flat[:, cells]
        flat[:] = 0.0
        flat[:, cells] = guess

    def _update_anchors(
        self, relative: FloatArray, prescribed: FloatArray, history: FloatArray
    ) -> None:
        """Store the place on the body to which each touching cell sticks."""
        cells = self._influence.cells
        tau_x, tau_y, pressure = self.traction.reshape(3, -1)[:, cells]
        touching = pressure > 0.0
        slipping = touching & (np.hypot(tau_x, tau_y) >= SLIP_FRACTION * self._bound)
        sticking = self.sticking.reshape(-1)
        fresh = cells[touching & (slipping | ~sticking[cells])]
        if self._indenter is not None and self._indenter.soft is not None:
            relative[:, cells] = self._relative_displacement() + history[:2, cells]
        self._set_anchors(fresh, self._rest[:, fresh] + relative[:, fresh], prescribed[2, fresh])
        sticking[:] = False
        sticking[cells] = touching
        self._slipping[:] = False
        self._slipping[cells] = slipping
        self._relative = relative

    def _set_anchors(self, cells: NDArray[np.int64], place: FloatArray, height: FloatArray) -> None:
        """Store where cells touch the body, at ``(2, f)`` places and ``(f,)`` heights, mm."""
        x, y = place - self._center[:2, None]
        z, turn = height - self._center[2], self._rotation
        for own in range(3):
            self._anchor_mm[own, cells] = turn[0, own] * x + turn[1, own] * y + turn[2, own] * z

    def _relative_displacement(self) -> FloatArray:
        """Return the displacement of the cells by the tractions, gel plus body, ``(2, c)``, mm."""
        shear = self.traction.reshape(3, -1)[:2, self._influence.cells]
        xx, xy, yy = self._influence.matrices[:3]
        sheared = lateral_displacement_kernel(xx, xy, yy, np.ascontiguousarray(shear, np.float32))
        return (sheared + self._pressure_shift).astype(np.float64)
