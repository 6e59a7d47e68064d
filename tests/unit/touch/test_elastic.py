"""The elastic layer, and contacts drawn on it."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from spikingtac.errors import ConfigError
from spikingtac.sim.layer import GridConfig, LayerOperator
from spikingtac.touch import elastic
from spikingtac.touch.elastic import FRICTION, SkinConfig, SurfaceResponse, synthetic_series
from stand_ins.pressed_skin import REFERENCE

SKIN = SkinConfig(shear_modulus_kpa=30.0, thickness_mm=3.0)


@pytest.mark.parametrize("direction", [0, 1, 2], ids=["along x", "along y", "pressing"])
def test_the_closed_form_is_the_fourier_solution(direction: int) -> None:
    cells = GridConfig(cells=128, span_mm=60.0)
    x, y = np.meshgrid(cells.axis_mm, cells.axis_mm)
    spread = np.exp(-0.5 * (x**2 + y**2))
    traction = np.zeros((3, 128, 128))
    traction[direction] = spread / (spread.sum() * cells.pitch_mm**2)
    moved = LayerOperator(cells, SKIN.thickness_mm).displacements(traction) * 1e3 / 30.0
    places = np.array([[2.5, 0.0], [0.0, 3.0], [4.0, -4.0], [7.0, 1.0]])
    axes = (cells.axis_mm, cells.axis_mm)
    expected = [
        RegularGridInterpolator(axes, one, method="cubic")(places[:, ::-1]) for one in moved
    ]
    found = SurfaceResponse(SKIN, 1.0, 20.0).matrix(places, np.zeros((1, 2)))[:, :, 0, direction]
    np.testing.assert_allclose(found, np.column_stack(expected), atol=0.02)


def test_contacts_that_are_drawn_obey_friction_and_repeat() -> None:
    first, again = (synthetic_series(SKIN, REFERENCE, 15.4, seed=3, frames=30) for _ in range(2))
    assert [one.name for one in first] == [f"synthetic {k}" for k in (1, 2, 3, 4, 5, 6)]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        shear = np.hypot(one.wrench[:, 0], one.wrench[:, 1])
        assert (shear <= FRICTION * one.wrench[:, 2] + 1e-9).all()
        assert one.wrench[:, 2].max() > 0.0
        assert np.abs(one.displacement).max() > 1.0


def test_a_press_towards_the_camera_moves_markers_outwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elastic, "NOISE_MM", 0.0)
    monkeypatch.setattr(elastic, "FRICTION", 0.0)
    near = SkinConfig(camera_distance_mm=13.0)
    flat, seen = (synthetic_series(skin, REFERENCE, 15.4, frames=40)[-1] for skin in (SKIN, near))
    np.testing.assert_array_equal(flat.wrench, seen.wrench)
    outwards = REFERENCE - REFERENCE.mean(axis=0)
    moved = seen.displacement - flat.displacement
    along = (moved * outwards).sum(axis=2) / np.hypot(*outwards.T)
    across = moved[..., 0] * outwards[:, 1] - moved[..., 1] * outwards[:, 0]
    pressed = flat.wrench[:, 2] > 1.0
    assert along[pressed].max(axis=1).min() > 0.5  # px
    assert np.abs(across).max() < 0.3 * np.abs(along * np.hypot(*outwards.T)).max()
    with pytest.raises(ConfigError, match="camera_distance_mm is 2"):
        SkinConfig(camera_distance_mm=2.0)
