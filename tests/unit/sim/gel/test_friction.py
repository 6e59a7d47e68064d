"""Stick and slip against Cattaneo and Mindlin, and the laws of Coulomb friction."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.sim.gel import Gel, GelConfig
from spikingtac.sim.indenters import IndenterConfig, make_indenter
from stand_ins.gels import (
    DT_S,
    MARKERS,
    MODULUS_MPA,
    THICK_CONTACT_MM,
    far_compliance,
    pose,
    press,
    thick_ball,
)

FRICTION = 0.8


def mindlin_shift_mm(share: float, force: float) -> float:
    """Return the shift at a share of the sliding force (Mindlin 1949; nu = 1/2), bond included."""
    stiff = 9.0 * FRICTION * force / (32.0 * MODULUS_MPA * THICK_CONTACT_MM)
    return stiff * (1.0 - (1.0 - share) ** (2.0 / 3.0)) + (
        share * FRICTION * force * far_compliance()[1]
    )


def test_partial_slip_of_a_ball_is_cattaneo_mindlin() -> None:
    gel, ball, force, approach = thick_ball()
    gel.step(DT_S, ball, pose(0.0, 0.0, approach))
    pressed = (gel.pressure_mpa > 0.0).sum()
    for share in (0.2, 0.4, 0.6, 0.8, 0.9):
        state = gel.step(DT_S, ball, pose(mindlin_shift_mm(share, force), 0.0, approach))
        assert state.force_n[0] == pytest.approx(share * FRICTION * force, rel=0.05)
        assert abs(state.force_n[1]) < 1e-3 * state.force_n[0]
        strength = np.hypot(*gel.shear_mpa)
        stuck = (gel.pressure_mpa > 0.0) & (strength < FRICTION * gel.pressure_mpa * (1 - 1e-5))
        expected = pressed * (1.0 - share) ** (2.0 / 3.0)  # area of the stuck disc
        assert stuck.sum() == pytest.approx(expected, rel=0.05, abs=12)


def test_sliding_meets_kinetic_friction_and_starts_above_it() -> None:
    gel = Gel(GelConfig(), MARKERS)
    ball = make_indenter(IndenterConfig(kind="ball"))
    press(gel, ball, 0.6, x=-4.0)
    ratios = []
    for step in range(100):
        state = gel.step(DT_S, ball, pose(-4.0 + 0.06 * (step + 1), 0.0, 0.6))
        ratios.append(state.force_n[0] / state.force_n[2])
    assert np.mean(ratios[-50:]) == pytest.approx(0.8 * FRICTION, abs=0.02)
    assert 0.8 * FRICTION < max(ratios) <= FRICTION
