"""The twin's truth of a contact against closed forms: patch, stuck part, wrench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.gel import Gel
from spikingtac.sim.gel_contact import FrictionConfig
from spikingtac.sim.motions import rotation_about
from stand_ins.gels import (
    DT_S,
    MARKERS,
    MODULUS_MPA,
    THICK_CONTACT_MM,
    THICK_GEL,
    pose,
    thick_ball,
)

NORMAL = np.array([0.0, 0.0, 1.0])


def test_the_torque_of_a_stuck_twist_is_reissner_and_sagoci() -> None:
    _, ball, _, approach = thick_ball()
    glued = FrictionConfig(static=20.0, tolerance_mm=THICK_GEL.friction.tolerance_mm)
    gel = Gel(replace(THICK_GEL, friction=glued), MARKERS)
    gel.step(DT_S, ball, pose(0.0, 0.0, approach))
    angle = 0.02
    state = gel.step(DT_S, ball, pose(0.0, 0.0, approach, rotation_about(NORMAL, angle)))
    expected = 16.0 / 3.0 * MODULUS_MPA * THICK_CONTACT_MM**3 * angle
    assert state.torque_n_mm[2] == pytest.approx(expected, rel=0.08)
    assert np.abs(state.force_n[:2]).max() < 1e-3 * state.force_n[2]
