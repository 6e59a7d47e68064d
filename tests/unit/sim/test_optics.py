import numpy as np
import pytest

from spikingtac.sim.optics import DiscConfig, draw_discs


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
