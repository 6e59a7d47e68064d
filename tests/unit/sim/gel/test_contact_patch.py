"""The twin's truth of a contact against closed forms: patch, stuck part, wrench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.sim.gel.contact import FrictionConfig
from spikingtac.sim.gel.gel import Gel
from spikingtac.sim.scene.motions import rotation_about
from spikingtac.sim.states import ContactPatch
from stand_ins.gels import (
    DT_S,
    MARKERS,
    MODULUS_MPA,
    THICK_CONTACT_MM,
    THICK_GEL,
    THICK_GRID,
    pose,
    thick_ball,
)

CELL_MM2 = THICK_GRID.pitch_mm**2
NORMAL = np.array([0.0, 0.0, 1.0])


def masks(patch: ContactPatch) -> tuple[np.ndarray, np.ndarray]:
    cells = THICK_GRID.cells
    both = (np.unpackbits(bits).reshape(cells, cells) for bits in (patch.touching, patch.sticking))
    touching, sticking = both
    return touching.astype(bool), sticking.astype(bool)


def test_a_pressed_ball_touches_the_disc_of_hertz_and_sticks_to_all_but_its_rim() -> None:
    gel, ball, force, approach = thick_ball()
    state = gel.step(DT_S, ball, pose(0.0, 0.0, approach))
    touching, sticking = masks(state.patch)
    assert touching.sum() * CELL_MM2 == pytest.approx(np.pi * THICK_CONTACT_MM**2, rel=0.05)
    x, y = np.meshgrid(THICK_GRID.axis_mm, THICK_GRID.axis_mm)
    assert np.hypot(x, y)[touching].max() < 1.1 * THICK_CONTACT_MM
    assert not (sticking & ~touching).any()
    assert sticking.sum() > 0.9 * touching.sum()
    assert state.force_n[2] == pytest.approx(force, rel=0.03)


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
