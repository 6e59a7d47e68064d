"""The bodies' height fields: shapes, poses, names."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.sim.indenters import INDENTERS, IndenterConfig, SoftLayer, make_indenter
from spikingtac.sim.motions import rotation_about

AXIS = np.linspace(-10.0, 10.0, 401)
X, Y = np.meshgrid(AXIS, AXIS)
UPRIGHT = np.eye(3)


@pytest.mark.parametrize("kind", list(INDENTERS))
def test_a_turn_about_the_normal_turns_the_shape(kind: str) -> None:
    body = make_indenter(IndenterConfig(kind=kind))
    quarter = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    turned = body.heights_mm(X, Y, quarter)
    # x towards y: clockwise on the page, since y runs downwards.
    near = turned > -0.4
    expected = np.rot90(body.heights_mm(X, Y, UPRIGHT), -1)
    np.testing.assert_allclose(turned[near], expected[near], atol=1e-6)


def test_wrong_names_are_named() -> None:
    with pytest.raises(ConfigError, match="did you mean 'spoon'"):
        make_indenter(IndenterConfig(kind="spon"))
    with pytest.raises(ConfigError, match="did you mean 'radius_mm'"):
        make_indenter(IndenterConfig(kind="punch", settings={"radius": 2.0}))
    with pytest.raises(ValueError, match="valid are"):
        SoftLayer(shear_modulus_kpa=0.0, thickness_mm=1.0)
