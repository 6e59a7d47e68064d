"""Normal contact against Hertz, complementarity, and the force against the stored energy."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.sim.gel.contact import FrictionConfig
from spikingtac.sim.gel.gel import Gel, GelConfig
from spikingtac.sim.gel.indenters import IndenterConfig, make_indenter
from stand_ins.gels import (
    DT_S,
    ELASTIC,
    MARKERS,
    THICK_CONTACT_MM,
    THICK_GRID,
    pose,
    press,
    thick_ball,
)

FRICTIONLESS = GelConfig(spectrum=ELASTIC, friction=FrictionConfig(static=0.0, tolerance_mm=1e-6))


def test_a_ball_on_a_thick_layer_is_hertz() -> None:
    gel, ball, force, approach = thick_ball()
    state = gel.step(DT_S, ball, pose(0.0, 0.0, approach))
    area = (gel.pressure_mpa > 0.0).sum() * THICK_GRID.pitch_mm**2
    peak = 1.5 * force / (np.pi * THICK_CONTACT_MM**2)
    assert state.force_n[2] == pytest.approx(force, rel=0.03)
    assert np.sqrt(area / np.pi) == pytest.approx(THICK_CONTACT_MM, rel=0.03)
    assert gel.pressure_mpa.max() == pytest.approx(peak, rel=0.03)
    x, y = np.meshgrid(THICK_GRID.axis_mm, THICK_GRID.axis_mm)
    share = 1.0 - (x**2 + y**2) / THICK_CONTACT_MM**2
    profile = peak * np.sqrt(np.maximum(share, 0.0))
    assert np.abs(gel.pressure_mpa - profile)[share > 0.2].max() < 0.03 * peak


def test_a_body_as_soft_as_the_gel_halves_the_pressing() -> None:
    soft = {"soft": {"shear_modulus_kpa": 30.0, "thickness_mm": 3.0}}
    gel = Gel(FRICTIONLESS, MARKERS)
    press(gel, make_indenter(IndenterConfig(kind="ball", settings=soft)), 0.6)
    # Equal layers share the approach evenly: the gel's surface moves by half of it.
    axis = FRICTIONLESS.grid.axis_mm
    x, y = np.meshgrid(axis, axis)
    pressed = gel.pressure_mpa > 0.0
    reach = 0.6 + make_indenter(IndenterConfig(kind="ball")).heights_mm(x, y, np.eye(3))
    np.testing.assert_allclose(gel.displacement_mm[2][pressed], 0.5 * reach[pressed], atol=0.01)
