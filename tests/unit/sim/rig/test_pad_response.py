"""The skin around the grasped rod: rigid inside the patch, an incompressible layer outside."""

import numpy as np
import pytest

from spikingtac.sim.rig.pad import Pad, PadConfig, mode_amplitudes
from spikingtac.sim.rig.pad_response import PatchConfig, pad_response, rigid_modes
from spikingtac.sim.rig.probe import ProbeConfig, ProbeState

PATCH = PatchConfig()


def test_the_patch_moves_rigidly_and_the_rim_follows_less() -> None:
    points = np.array([[0.0, 8.0], [3.0, 0.0], [5.0, 0.0], [12.0, 0.0]])
    response = pad_response(PATCH, points)
    np.testing.assert_allclose(response.displacement[:, :2], rigid_modes(points[:2]), atol=1e-12)
    lateral = response.displacement[0, :, 0]
    assert 1.0 > lateral[2] > 0.3
    assert abs(lateral[3]) < 0.1


def test_pressing_drives_the_skin_outward() -> None:
    response = pad_response(PATCH, np.array([[6.0, 0.0], [-6.0, 0.0], [0.0, 11.0]]))
    press = response.displacement[2]
    assert press[0, 0] > 0.2
    assert press[1, 0] < -0.2
    assert press[2, 1] > 0.2
    assert (press[:, 2] < 0.0).all()


def test_the_patch_edge_is_continuous() -> None:
    points = np.array([[3.45, 0.0], [3.55, 0.0]])
    response = pad_response(PATCH, points)
    jump = np.abs(response.displacement[:, 1] - response.displacement[:, 0])
    assert jump[:2].max() < 0.15


def test_the_gradient_is_the_slope_of_the_displacement() -> None:
    step = 0.05
    points = np.array([[6.0, 2.0], [6.0 + step, 2.0], [6.0, 2.0 + step]])
    response = pad_response(PATCH, points)
    slope = np.stack(
        [(response.displacement[:, k] - response.displacement[:, 0])[:, :2] for k in (1, 2)], -1
    )
    np.testing.assert_allclose(response.gradient[:, 0], slope / step, atol=0.08)


def test_stiffness_has_the_order_of_the_shear_estimate() -> None:
    """Twice mu A / h is 2.5 N/mm for the bare patch; its rim adds to that."""
    response = pad_response(PATCH, np.zeros((1, 2)))
    both_pads = 2 * 0.03 * response.stiffness
    assert 2.5 < both_pads[1] < both_pads[0] < 6.0
    assert 68.0 < both_pads[3] < 220.0
    assert 5.0 < both_pads[2] / both_pads[0] < 9.0
    assert 3.0 < both_pads[5] / both_pads[3] < 6.0


@pytest.mark.parametrize("faces_back", [False, True])
def test_modes_reproduce_the_rigid_motion_of_the_surface(faces_back: bool) -> None:
    rng = np.random.default_rng(1)
    bushing = rng.normal(size=6)
    side = 1.0 if faces_back else -1.0
    axes = np.diag([-side, 1.0, side])
    points = rng.uniform(-3, 3, (5, 2))
    at = np.column_stack([points, np.zeros(5)]) @ axes + [0.0, 0.0, side * 2.0]
    moved = bushing[:3] + np.cross(bushing[3:], at)
    amplitude = mode_amplitudes(2.0, faces_back) @ bushing
    fields = np.tensordot(amplitude, rigid_modes(points), axes=1)
    np.testing.assert_allclose(fields, moved @ axes.T, atol=1e-12)


def state(bushing: np.ndarray, force: np.ndarray) -> ProbeState:
    tip, center = np.zeros(3), np.array([0.0, 0.0, 40.0])
    return ProbeState(0, tip, tip, center, bushing, force, 0.0, 0.0, True)


def test_two_pads_see_the_same_motion_mirrored() -> None:
    rotation = ProbeConfig().rotation()
    bushing = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.01])
    pads = [Pad(PadConfig(), PATCH, back) for back in (False, True)]
    force = np.array([-0.04, 0.0, 0.0])
    skins = [pad.skin(state(bushing, force), rotation) for pad in pads]
    flip = skins[1].marker_mm.reshape(8, 8, 3)[:, ::-1] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(skins[0].marker_mm.reshape(8, 8, 3), flip, atol=1e-3)
    assert skins[0].force_n[0] == pytest.approx(-0.02)
    assert skins[1].force_n[0] == pytest.approx(0.02)
    assert skins[0].torque_n_mm[2] == pytest.approx(0.8)
