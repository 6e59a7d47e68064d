import numpy as np
import pytest

from spikingtac.sim.optics import DiscConfig, Optics, OpticsConfig, SkinState, draw_discs

STRAIGHT = OpticsConfig(k1=0.0)
BENT = OpticsConfig(k1=-0.06, k2=0.01)


def skin(marker_mm, gradient=None) -> SkinState:
    marker_mm = np.array(marker_mm, np.float64)
    if gradient is None:
        gradient = np.tile(np.eye(2), (len(marker_mm), 1, 1))
    return SkinState(0, marker_mm, gradient)


def test_an_indentation_magnifies_as_the_distance_shrinks(discs_in_their_places):
    rest, pressed = skin([[9.0, 0, 0]]), skin([[9.0, 0, 0.6]])
    optics = Optics(STRAIGHT)
    moved = optics.project(pressed).center_px - optics.project(rest).center_px
    r_px = 9.0 * 15.5
    assert moved[0, 0] == pytest.approx(r_px * 0.6 / (13.0 - 0.6))
    shape = optics.project(pressed).shape[0]
    np.testing.assert_allclose(shape, np.eye(2) * (13.0 - 0.6) / 13.0, atol=1e-12)


@pytest.mark.parametrize("lens", [STRAIGHT, BENT])
def test_a_discs_rim_maps_onto_the_images_ellipse(lens, discs_in_their_places):
    gradient = np.array([[[1.1, 0.07], [-0.04, 0.9]]])
    center = np.array([[5.0, -6.0, 0.3]])
    optics = Optics(lens)
    image = optics.project(skin(center, gradient))
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    tiny_mm = 1e-4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rim = np.concatenate([center[:, :2] + tiny_mm @ gradient[0].T, np.full((12, 1), 0.3)], axis=1)
    offset_px = optics.project(skin(rim)).center_px - image.center_px
    np.testing.assert_allclose(offset_px @ image.shape[0].T, tiny_mm * 15.5, rtol=1e-3, atol=1e-8)


def test_equal_seeds_are_one_skin_and_damage_changes_no_other_marker():
    whole = draw_discs(DiscConfig(), 64, seed=4)
    damaged = draw_discs(DiscConfig(broken=(3,), missing=(5, 6)), 64, seed=4)
    kept = np.setdiff1d(np.arange(64), [5, 6])
    (whole_mm, offset_mm, _), (radius_mm, same_mm, chord) = whole, damaged
    np.testing.assert_array_equal(whole_mm[kept], radius_mm[kept])
    np.testing.assert_array_equal(offset_mm, same_mm)
    assert radius_mm[[5, 6]].tolist() == [0.0, 0.0]
    assert np.flatnonzero(np.isfinite(chord[:, 2])).tolist() == [3]
    assert chord[3, 2] == 0.0
    assert not np.array_equal(draw_discs(DiscConfig(), 64, seed=5)[1], offset_mm)
