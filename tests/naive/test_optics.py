"""The lens's kernel and the markers' records against the same on arrays."""

import numpy as np
import pytest

from spikingtac.sim.camera.coverage import discs_of
from spikingtac.sim.optics import DiscConfig, Optics, OpticsConfig, draw_discs
from spikingtac.sim.states import MarkerImage, SkinState

LENSES = [
    OpticsConfig(),
    OpticsConfig(k1=-0.06, k2=0.01, size=(301, 341)),
    OpticsConfig(discs=DiscConfig(broken=(3, 9), missing=(5,))),
]


def plain_distort(lens: OpticsConfig, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return px ``(n, 2)`` and d px / d mm ``(n, 2, 2)`` at ``(n, 3)`` points."""
    scale = 1.0 / (lens.distance_mm - points_mm[:, 2])
    x, y = points_mm[:, :2].T * scale
    square = x**2 + y**2
    radial, slope = 1 + lens.k1 * square + lens.k2 * square**2, 2 * lens.k1 + 4 * lens.k2 * square
    bent = [x * radial, y * radial]
    across = slope * x * y
    along_x, along_y = radial + slope * x**2, radial + slope * y**2
    jacobian = np.array([[along_x, across], [across, along_y]]).transpose(2, 0, 1)
    center = np.array([(lens.size[0] - 1) / 2, (lens.size[1] - 1) / 2])
    focal_px = lens.px_per_mm * lens.distance_mm
    return center + focal_px * np.stack(bent, 1), (focal_px * scale)[:, None, None] * jacobian


def random_skin(rng: np.random.Generator) -> SkinState:
    place = np.column_stack([rng.uniform(-9.0, 9.0, (64, 2)), rng.uniform(-0.5, 0.8, 64)])
    gradient = np.eye(2) + rng.normal(scale=0.1, size=(64, 2, 2))
    zero = np.zeros(3)
    return SkinState(0, place, gradient, zero, zero, zero, in_contact=True)


@pytest.mark.parametrize("lens", LENSES, ids=["barrel", "decentred", "damaged"])
def test_markers_are_projected_and_recorded_as_on_arrays(lens: OpticsConfig) -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        skin, discs = random_skin(rng), draw_discs(lens.discs, 64, seed=4)
        image = Optics(lens, seed=4).project(skin)
        place = skin.marker_mm.copy()
        place[:, :2] += np.einsum("mij,mj->mi", skin.gradient, discs.offset_mm)
        center, jacobian = plain_distort(lens, place)
        shape = lens.px_per_mm * np.linalg.inv(jacobian @ skin.gradient)
        np.testing.assert_allclose(image.center_px, center, rtol=0, atol=1e-9)
        np.testing.assert_allclose(image.shape, shape, rtol=0, atol=1e-12)
        assert_recorded(image)


def assert_recorded(image: MarkerImage) -> None:
    records = discs_of(image)
    columns = [records[name] for name in ("x", "y", "xx", "xy", "yx", "yy", "radius")]
    shape = image.shape.reshape(-1, 4)
    np.testing.assert_array_equal(
        np.stack(columns, axis=1), np.column_stack([image.center_px, shape, image.radius_px])
    )
    scale = np.sqrt(np.abs(np.linalg.det(image.shape)))
    np.testing.assert_allclose(records["scale"], scale, rtol=1e-12)
    chord = np.tile([0.0, 0.0, np.inf], (len(records), 1)) if image.chord is None else image.chord
    cuts = np.stack([records[name] for name in ("chord_x", "chord_y", "chord_px")], axis=1)
    np.testing.assert_array_equal(cuts, chord)
