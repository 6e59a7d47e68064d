"""Normal contact against Hertz, complementarity, and the force against the stored energy."""

from __future__ import annotations

import numpy as np
import pytest

from stand_ins.gels import (
    DT_S,
    THICK_CONTACT_MM,
    THICK_GRID,
    pose,
    thick_ball,
)


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
