"""The bodies' height fields: shapes, poses, names."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.sim.gel.indenters import INDENTERS, IndenterConfig, SoftLayer, make_indenter
from spikingtac.sim.scene.motions import rotation_about

AXIS = np.linspace(-10.0, 10.0, 401)
X, Y = np.meshgrid(AXIS, AXIS)
UPRIGHT = np.eye(3)


@pytest.mark.parametrize("kind", list(INDENTERS))
def test_the_deepest_point_is_the_pose(kind: str) -> None:
    heights = make_indenter(IndenterConfig(kind=kind)).heights_mm(X, Y, UPRIGHT)
    assert heights.shape == X.shape
    assert heights.max() == pytest.approx(0.0, abs=1e-3)
    assert np.isfinite(heights).all()


@pytest.mark.parametrize("kind", list(INDENTERS))
def test_a_turn_about_the_normal_turns_the_shape(kind: str) -> None:
    body = make_indenter(IndenterConfig(kind=kind))
    quarter = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    turned = body.heights_mm(X, Y, quarter)
    # x towards y: clockwise on the page, since y runs downwards.
    near = turned > -0.4
    expected = np.rot90(body.heights_mm(X, Y, UPRIGHT), -1)
    np.testing.assert_allclose(turned[near], expected[near], atol=1e-6)


def test_a_ball_is_a_sphere_in_any_orientation() -> None:
    body = make_indenter(IndenterConfig(kind="ball"))
    r2 = X**2 + Y**2
    inside = r2 < 15.0
    expected = np.sqrt(16.0 - r2[inside]) - 4.0
    for angle in (0.0, 0.7):
        turn = rotation_about(np.array([0.6, 0.8, 0.0]), angle)
        np.testing.assert_allclose(body.heights_mm(X, Y, turn)[inside], expected, atol=1e-9)
        assert body.center_mm(turn) == pytest.approx(-4.0)


def test_a_spoon_has_its_two_curvatures() -> None:
    body = make_indenter(IndenterConfig(kind="spoon"))
    small = 0.1
    for x, y, radius in ((small, 0.0, 15.0), (0.0, small, 10.0)):
        height = body.heights_mm(np.array([x]), np.array([y]), UPRIGHT)[0]
        assert -(small**2) / (2.0 * height) == pytest.approx(radius, rel=1e-3)


def test_a_tilted_spoon_is_that_ellipsoid() -> None:
    body = make_indenter(IndenterConfig(kind="spoon"))
    turn = rotation_about(np.array([1.0, 0.0, 0.0]), 0.3)
    heights = body.heights_mm(X, Y, turn)
    near = heights > -3.0
    surface = np.stack((X[near], Y[near], heights[near] - body.center_mm(turn)))
    own = turn.T @ surface
    squares = np.array([15.0 * 8.0, 10.0 * 8.0, 64.0])
    np.testing.assert_allclose((own**2 / squares[:, None]).sum(axis=0), 1.0, atol=1e-9)


def test_a_comb_has_its_teeth() -> None:
    heights = make_indenter(IndenterConfig(kind="comb")).heights_mm(AXIS, 0.0 * AXIS, UPRIGHT)
    peaks = AXIS[np.flatnonzero(heights > -1e-9)]
    np.testing.assert_allclose(peaks, [-5.0, -3.0, -1.0, 1.0, 3.0, 5.0], atol=1e-9)
    assert heights[np.abs(AXIS) < 0.4].max() < -100.0


def test_a_punch_is_flat_with_a_round_rim() -> None:
    body = make_indenter(IndenterConfig(kind="punch"))
    heights = body.heights_mm(np.array([0.0, 2.4, 2.8, 3.1]), np.zeros(4), UPRIGHT)
    np.testing.assert_allclose(heights[:3], [0.0, 0.0, np.sqrt(0.25 - 0.09) - 0.5], atol=1e-12)
    assert heights[3] < -100.0


def test_a_tilted_punch_stands_on_its_edge() -> None:
    body = make_indenter(IndenterConfig(kind="punch"))
    turn = rotation_about(np.array([0.0, 1.0, 0.0]), 0.1)
    heights = body.heights_mm(np.array([-2.5, 0.0, 2.5]), np.zeros(3), turn)
    np.testing.assert_allclose(np.diff(heights), -2.5 * np.tan(0.1), atol=1e-9)
    assert heights.max() == pytest.approx(0.0, abs=1e-9)


def test_only_the_finger_is_soft_unless_told() -> None:
    soft = {kind for kind in INDENTERS if make_indenter(IndenterConfig(kind=kind)).soft}
    assert soft == {"finger"}
    settings = {"soft": {"shear_modulus_kpa": 50.0, "thickness_mm": 4.0}}
    body = make_indenter(IndenterConfig(kind="ball", settings=settings))
    assert body.soft == SoftLayer(shear_modulus_kpa=50.0, thickness_mm=4.0)


def test_wrong_names_are_named() -> None:
    with pytest.raises(ConfigError, match="did you mean 'spoon'"):
        make_indenter(IndenterConfig(kind="spon"))
    with pytest.raises(ConfigError, match="did you mean 'radius_mm'"):
        make_indenter(IndenterConfig(kind="punch", settings={"radius": 2.0}))
    with pytest.raises(ValueError, match="valid are"):
        SoftLayer(shear_modulus_kpa=0.0, thickness_mm=1.0)
