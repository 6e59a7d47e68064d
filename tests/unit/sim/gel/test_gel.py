"""The gel as a whole: memory, stuck and turning patches, rest, and what it hands on."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import SpikingTacError
from spikingtac.sim.gel import Gel, GelConfig
from spikingtac.sim.gel_contact import FrictionConfig
from spikingtac.sim.indenters import Indenter, IndenterConfig, make_indenter
from spikingtac.sim.motions import rotation_about
from stand_ins.gels import DT_S, MARKERS, pose, press

PX_PER_MM = 15.5
GLUED = GelConfig(friction=FrictionConfig(static=20.0))
NORMAL = np.array([0.0, 0.0, 1.0])


def body(kind: str, **settings: float) -> Indenter:
    return make_indenter(IndenterConfig(kind=kind, settings=settings))


def test_residual_after_unloading_equals_the_prediction() -> None:
    ball, shift = body("ball"), 12.0 / PX_PER_MM
    left: dict[float, np.ndarray] = {}
    for shear in (0.0, shift):
        gel = Gel(GLUED, MARKERS)
        pressed = press(gel, ball, 0.8).marker_mm
        for step in range(1, 6):
            state = gel.step(DT_S, ball, pose(shear * step / 5, 0.0, 0.8))
        sheared = state.marker_mm - pressed
        for _ in range(1245):
            gel.step(DT_S, ball, pose(shear, 0.0, 0.8))
        times = np.diff([0.0, 0.1, 1.0, 2.0, 5.0])
        left[shear] = np.array([gel.step(dt, None, None).marker_mm for dt in times])
    share = (left[shift] - left[0.0])[:, :4, 0] / sheared[:4, 0]
    assert sheared[0, 0] * PX_PER_MM == pytest.approx(12.0, rel=0.01)
    expected = np.array([[0.95], [0.53], [0.45], [0.31]])
    np.testing.assert_allclose(12.0 * share, np.broadcast_to(expected, share.shape), rtol=0.03)


def test_markers_turn_with_a_stuck_patch_however_far() -> None:
    gel, punch = Gel(GLUED, MARKERS), body("punch", radius_mm=4.0)
    pressed = press(gel, punch, 0.5)
    for degree in range(1, 121):
        turn = rotation_about(NORMAL, np.radians(degree))
        state = gel.step(DT_S, punch, pose(0.0, 0.0, 0.5, turn))
    expected = pressed.marker_mm[:3, :2] @ turn[:2, :2].T
    np.testing.assert_allclose(state.marker_mm[:3, :2], expected, atol=0.005)
    np.testing.assert_allclose(state.gradient[1], turn[:2, :2] @ pressed.gradient[1], atol=0.02)
    assert state.torque_n_mm[2] > 1.0


def test_a_contact_beyond_the_solver_is_refused() -> None:
    gel = Gel(GelConfig(), MARKERS)
    with pytest.raises(SpikingTacError, match="press less deeply"):
        gel.step(DT_S, body("punch", radius_mm=12.9), pose(0.0, 0.0, 0.5))
