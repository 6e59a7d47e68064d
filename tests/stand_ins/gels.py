"""Gels, poses and a thick layer that the tests of the twin's mechanics share."""

from __future__ import annotations

import numpy as np
from scipy.integrate import trapezoid

from spikingtac.sim.gel import Gel, GelConfig, SpectrumConfig
from spikingtac.sim.gel_contact import FrictionConfig
from spikingtac.sim.indenters import Ellipsoid, Indenter
from spikingtac.sim.layer import GridConfig, layer_response
from spikingtac.sim.optics import SkinState
from spikingtac.types import Pose

ELASTIC = SpectrumConfig(fractions=(), times_s=())
MARKERS = np.array([[0.0, 0.0], [0.8, 0.3], [2.5, 0.0], [4.0, 1.0], [-5.0, 6.0]])
DT_S = 0.004

THICK_RADIUS_MM = 10.0
THICK_GRID = GridConfig(cells=256, span_mm=26.0)
THICK_CONTACT_MM = 10 * THICK_GRID.pitch_mm
THICK_GEL = GelConfig(
    thickness_mm=8 * THICK_CONTACT_MM,
    spectrum=ELASTIC,
    friction=FrictionConfig(kinetic_ratio=1.0, tolerance_mm=1e-6),
    grid=THICK_GRID,
)
MODULUS_MPA = 0.03


def pose(x: float, y: float, depth: float, rotation: np.ndarray | None = None) -> Pose:
    return Pose(np.array([x, y, depth]), np.eye(3) if rotation is None else rotation)


def press(gel: Gel, indenter: Indenter, depth: float, x: float = 0.0, steps: int = 50) -> SkinState:
    """Press to a depth within 0.2 s and return the last state."""
    for step in range(steps - 1):
        gel.step(DT_S, indenter, pose(x, 0.0, depth * (step + 1) / steps))
    return gel.step(DT_S, indenter, pose(x, 0.0, depth))


def thick_ball() -> tuple[Gel, Ellipsoid, float, float]:
    """Return a gel of 8 contact radii with a ball, its Hertz force (N) and approach (mm)."""
    ball = Ellipsoid(radius_x_mm=THICK_RADIUS_MM, radius_y_mm=THICK_RADIUS_MM)
    force = 16.0 / 3.0 * MODULUS_MPA * THICK_CONTACT_MM**3 / THICK_RADIUS_MM
    approach = THICK_CONTACT_MM**2 / THICK_RADIUS_MM + force * far_compliance()[0]
    return Gel(THICK_GEL, MARKERS), ball, force, approach


def far_compliance() -> tuple[float, float]:
    """Return what the bond at depth h changes at the contact, normal and lateral, mm/N.

    The first term of the difference between layer and half-space under a point force.
    """
    k = np.linspace(1e-6, 60.0 / THICK_GEL.thickness_mm, 100_000)
    response = layer_response(k, THICK_GEL.thickness_mm)
    normal = trapezoid((response.normal - 0.5 / k) * k, k)
    both = response.longitudinal + response.transverse - 1.5 / k
    lateral = trapezoid(0.5 * both * k, k)
    return normal / (2.0 * np.pi * MODULUS_MPA), lateral / (2.0 * np.pi * MODULUS_MPA)
