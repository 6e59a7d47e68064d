"""The skin around the grasped rod: rigid inside the patch, an incompressible layer outside."""

import numpy as np
import pytest

from spikingtac.sim.rig.pad import mode_amplitudes, pad_response, rigid_modes


def test_the_patch_moves_rigidly_and_the_rim_follows_less() -> None:
    points = np.array([[0.0, 8.0], [3.0, 0.0], [5.0, 0.0], [12.0, 0.0]])
    displacement, _ = pad_response(points)
    np.testing.assert_allclose(displacement[:, :2], rigid_modes(points[:2]), atol=1e-12)
    lateral = displacement[0, :, 0]
    assert 1.0 > lateral[2] > 0.3
    assert abs(lateral[3]) < 0.1


@pytest.mark.parametrize("faces_back", [False, True])
def test_modes_reproduce_the_rigid_motion_of_the_surface(faces_back: bool) -> None:
    rng = np.random.default_rng(1)
    bushing = rng.normal(size=6)
    side = 1.0 if faces_back else -1.0
    axes = np.diag([-side, 1.0, side])
    points = rng.uniform(-3, 3, (5, 2))
    at = np.column_stack([points, np.zeros(5)]) @ axes + [0.0, 0.0, side * 2.0]
    moved = bushing[:3] + np.cross(bushing[3:], at)
    amplitude = mode_amplitudes(faces_back) @ bushing
    fields = np.tensordot(amplitude, rigid_modes(points), axes=1)
    np.testing.assert_allclose(fields, moved @ axes.T, atol=1e-12)
