import numpy as np
import pytest

from spikingtac.sim.optics import DiscConfig, Optics, OpticsConfig, draw_discs
from spikingtac.sim.states import SkinState

EXACT = DiscConfig(radius_sigma_mm=0.0, position_sigma_mm=0.0)
STRAIGHT = OpticsConfig(k1=0.0, discs=EXACT)


def skin(marker_mm, gradient=None) -> SkinState:
    marker_mm = np.array(marker_mm, np.float64)
    if gradient is None:
        gradient = np.tile(np.eye(2), (len(marker_mm), 1, 1))
    zero = np.zeros(3)
    return SkinState(0, marker_mm, gradient, zero, zero, zero, in_contact=False)


def test_an_indentation_magnifies_as_the_distance_shrinks():
    rest, pressed = skin([[9.0, 0, 0]]), skin([[9.0, 0, 0.6]])
    optics = Optics(STRAIGHT)
    moved = optics.project(pressed).center_px - optics.project(rest).center_px
    r_px = 9.0 * 15.5
    assert moved[0, 0] == pytest.approx(r_px * 0.6 / (13.0 - 0.6))
    shape = optics.project(pressed).shape[0]
    np.testing.assert_allclose(shape, np.eye(2) * (13.0 - 0.6) / 13.0, atol=1e-12)


def test_equal_seeds_are_one_skin_and_damage_changes_no_other_marker():
    whole = draw_discs(DiscConfig(), 64, seed=4)
    damaged = draw_discs(DiscConfig(broken=(3,), missing=(5, 6), broken_share=0.25), 64, seed=4)
    kept = np.setdiff1d(np.arange(64), [5, 6])
    np.testing.assert_array_equal(whole.radius_mm[kept], damaged.radius_mm[kept])
    np.testing.assert_array_equal(whole.offset_mm, damaged.offset_mm)
    assert damaged.radius_mm[[5, 6]].tolist() == [0.0, 0.0]
    assert np.flatnonzero(np.isfinite(damaged.chord[:, 2])).tolist() == [3]
    assert damaged.chord[3, 2] == pytest.approx(-0.5 * damaged.radius_mm[3])
    other = draw_discs(DiscConfig(), 64, seed=5)
    assert not np.array_equal(other.offset_mm, whole.offset_mm)
