"""Contact of one body with the gel: which cells touch, press, stick and slip in each step.

The grid is fixed to the skin, so that a cell is a piece of material. The body meets a cell at its
displaced place. A body that drags or turns a sticking patch therefore stays on the same cells.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import SpikingTacError
from spikingtac.sim.gel_solvers import (
    Influence,
    lateral_displacement_kernel,
    pressure_kernel,
    product_kernel,
    shear_kernel,
)
from spikingtac.sim.indenters import Indenter, SoftLayer
from spikingtac.sim.layer import GridConfig, LayerOperator
from spikingtac.types import KPA_PER_MPA, FloatArray, Pose

KINETIC_RATIO = 0.8  # Friction of a slipping cell over that of a sticking one (dry silicone).
TOLERANCE_MM = 1e-4  # Error of the displacement at which the iterations end, mm (0.002 px).

# Distance from the body, in sides of a cell, below which a cell is solved for.
NEAR_FRACTION = 0.05

# Largest number of cells in one contact: six dense matrices of that size take 300 MB.
MAX_CELLS = 2500

# Limit of the conjugate gradients; a cold start takes about 10, a warm one about 5.
MAX_ITERATIONS = 400
MAX_SWEEPS = 400  # Limit of the friction sweeps; a cold start takes about 20, a warm one about 6.

# Limit of how often the set of cells grows in one step, where the gel bulges into the body.
MAX_EXTENSIONS = 4

# Fraction of the friction bound from which a cell, or a point of a tip, counts as slipping
# (rounding only).
SLIP_FRACTION = 1.0 - 1e-6


class GelContact:
    """State of the contact between the gel and one body.

    Args:
        grid: Cells of the skin.
        layer: Elastic response of the gel.
        friction: Coefficient of friction while a cell sticks.

    Attributes:
        friction: The same.
        traction: ``(3, n, n)`` shear along x and y, and pressure, N/mm².
    """

    def __init__(self, grid: GridConfig, layer: LayerOperator, friction: float) -> None:
        self._grid, self._layer, self.friction = grid, layer, friction
        self._near_mm = NEAR_FRACTION * grid.pitch_mm
        self._rest = np.stack(np.meshgrid(grid.axis_mm, grid.axis_mm)).reshape(2, -1)
        self.traction = np.zeros((3, grid.cells, grid.cells))
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
        self._sticking, self._slipping = np.zeros((2, cells), np.bool_)
        self._traction_change, self._anchor_mm = np.zeros((2, 3, cells))
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
    def patch(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Which cells touch, and which of these stick, as bits; see ``SkinState``."""
        touching = self.traction[2].ravel() > 0.0
        return np.packbits(touching), np.packbits(touching & ~self._slipping)

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
        needed = before[2].ravel() - prescribed[2] < self._near_mm
        needed[self.cells] |= self.traction[2].ravel()[self.cells] > 0.0
        if not needed.any():
            self.release()
            return None
        flat = history.reshape(3, -1)
        moved = self._solve(needed, compliance, prescribed, flat)
        for _ in range(MAX_EXTENSIONS):  # again with more cells where the gel bulges into the body
            needed = prescribed[2] - flat[2] - compliance * moved[2].ravel() > self._near_mm
            needed[self.cells] = False
            if not needed.any():
                break
            needed[self.cells] = True
            moved = self._solve(needed, compliance, prescribed, flat)
        relative = compliance * moved.reshape(3, -1)[:2] + flat[:2]
        self._update_anchors(relative, prescribed, flat, (pose.rotation, center))
        return moved

    def _prescribed(
        self, indenter: Indenter, pose: Pose, center: FloatArray, before: FloatArray
    ) -> FloatArray:
        """Return each cell's displacement if it sticks (x, y) or is pressed (z), ``(3, n²)``."""
        prescribed = before.reshape(3, -1).copy()
        if self._relative is not None:
            prescribed[:2] = self._relative
        stuck = np.flatnonzero(self._sticking)
        anchor_mm = self._anchor_mm.take(stuck, axis=1)
        for axis in range(2):  # each sum in this order, so that its last digits are fixed
            carried = center[axis] + pose.rotation[axis, 0] * anchor_mm[0]
            carried = carried + pose.rotation[axis, 1] * anchor_mm[1]
            carried = carried + pose.rotation[axis, 2] * anchor_mm[2]
            prescribed[axis, stuck] = carried - self._rest[axis, stuck]
        x, y = self._rest + prescribed[:2] - pose.position_mm[:2, None]
        prescribed[2] = pose.position_mm[2] + indenter.heights_mm(x, y, pose.rotation)
        return prescribed

    def _update_influence(self, chosen: NDArray[np.bool_], compliance: float) -> None:
        """Update the influence matrices for the cells, the compliance of the step and the body."""
        if chosen.sum() > MAX_CELLS:
            raise SpikingTacError(
                f"the contact covers {chosen.sum()} cells, the most is {MAX_CELLS}; press "
                "less deeply, take a smaller indenter or a coarser grid"
            )
        soft = None if self._indenter is None else self._indenter.soft
        if (soft, compliance) != self._influence_key:
            tables = compliance * self._layer.tables
            if soft is not None:
                body = LayerOperator(self._grid, soft.thickness_mm).tables
                # The body faces the gel, so that its lateral response to pressure turns its sign.
                facing = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])[:, None, None]
                tables = tables + facing * body * KPA_PER_MPA / soft.shear_modulus_kpa
            self._influence_key, self._influence = (soft, compliance), Influence(tables)
        self._influence.set_cells(chosen)

    def _solve(
        self,
        chosen: NDArray[np.bool_],
        compliance: float,
        prescribed: FloatArray,
        history: FloatArray,
    ) -> FloatArray:
        """Solve pressure, then friction; return the displacement at unit compliance."""
        self._update_influence(chosen, compliance)
        cells = self.cells
        xx, xy, yy, zz, xz, yz = self._influence.matrices
        flat = self.traction.reshape(3, -1)
        former = flat.take(cells, axis=1)
        # The first guesses extrapolate the last step.
        guess = (former + self._traction_change.take(cells, axis=1)).astype(np.float32)
        guess[2, former[2] == 0.0] = 0.0
        target = (prescribed.take(cells, axis=1) - history.take(cells, axis=1)).astype(np.float32)
        shear, pressure = guess[:2], guess[2]
        target[2] += product_kernel(xz, shear[0]) + product_kernel(yz, shear[1])
        pressure_kernel(zz, target[2], pressure, TOLERANCE_MM, MAX_ITERATIONS)
        pressure_shift = np.stack((product_kernel(xz, pressure), product_kernel(yz, pressure)))
        target[:2] -= pressure_shift
        coefficient = np.where(self._slipping[cells], KINETIC_RATIO, 1.0)
        bound = (self.friction * coefficient * pressure).astype(np.float32)
        shear_kernel(xx, xy, yy, target[:2], bound, shear, TOLERANCE_MM, MAX_SWEEPS)
        self._bound, self._pressure_shift = bound, pressure_shift
        self._traction_change[:] = 0.0
        self._traction_change[:, cells] = guess - former
        flat[:] = 0.0
        flat[:, cells] = guess
        return self._layer.displacements(self.traction)

    def _update_anchors(
        self,
        relative: FloatArray,
        prescribed: FloatArray,
        history: FloatArray,
        frame: tuple[FloatArray, FloatArray],
    ) -> None:
        """Store the place on the body, in its own frame, to which each touching cell sticks."""
        cells, (turn, center) = self.cells, frame
        tau_x, tau_y, pressure = self.traction.reshape(3, -1).take(cells, axis=1)
        touching = pressure > 0.0
        slipping = touching & (np.hypot(tau_x, tau_y) >= SLIP_FRACTION * self._bound)
        if self._indenter is not None and self._indenter.soft is not None:  # gel plus body
            shear = np.stack((tau_x, tau_y)).astype(np.float32)
            xx, xy, yy = self._influence.matrices[:3]
            sheared = lateral_displacement_kernel(xx, xy, yy, shear)
            shift = (sheared + self._pressure_shift).astype(np.float64)
            relative[:, cells] = shift + history[:2].take(cells, axis=1)
        fresh = cells[touching & (slipping | ~self._sticking[cells])]
        place = self._rest.take(fresh, axis=1) + relative.take(fresh, axis=1)
        (x, y), z = place - center[:2, None], prescribed[2, fresh] - center[2]
        for own in range(3):
            self._anchor_mm[own, fresh] = turn[0, own] * x + turn[1, own] * y + turn[2, own] * z
        self._sticking[:] = self._slipping[:] = False
        self._sticking[cells], self._slipping[cells] = touching, slipping
        self._relative = relative
