"""The touched part of the skin, from its markers' motion: known contacts of the twin's gel."""

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from spikingtac.sim.gel import Gel, GelConfig
from spikingtac.sim.indenters import IndenterConfig, make_indenter
from spikingtac.sim.motions import IndenterMotion, MotionConfig, SegmentConfig, rotation_about
from spikingtac.sim.scene import SkinConfig
from spikingtac.touch.patch import Patch, PatchEstimator, SquareLattice

PITCH_MM, DISTANCE_MM = 2.4, 13.0
GRID = SkinConfig().rest_mm()
PRESSES = [
    ("ball", {"radius_x_mm": 6.0, "radius_y_mm": 6.0}, 0.6, (1.0, -0.5)),
    ("punch", {"radius_mm": 3.0}, 0.3, (-1.3, 2.1)),
    ("finger", {}, 1.6, (0.4, 0.9)),
    ("spoon", {}, 0.6, (2.0, -1.0)),
]


def turned(places: np.ndarray, degrees: float) -> np.ndarray:
    return places @ rotation_about(np.array([0.0, 0.0, 1.0]), np.radians(degrees))[:2, :2].T


def hexagonal() -> np.ndarray:
    """Markers in rows that are shifted against each other, as many to an area as the grid's."""
    pitch = PITCH_MM * np.sqrt(2.0 / np.sqrt(3.0))
    row, column = np.mgrid[-4:5, -4:5].reshape(2, -1)
    places = pitch * np.column_stack([column + 0.5 * (row % 2), row * np.sqrt(0.75)])
    return places[np.abs(places).max(axis=1) < 9.0]


def pressed(
    kind: str, settings: dict, depth_mm: float, place_mm: tuple[float, float], markers: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacements of markers before a camera, the cells of the skin (mm), which are touched."""
    segment = SegmentConfig(kind="press", depth_mm=depth_mm, duration_s=0.2)
    x_mm, y_mm = place_mm
    motion = IndenterMotion(MotionConfig(x_mm=x_mm, y_mm=y_mm, height_mm=0.1, segments=(segment,)))
    body = make_indenter(IndenterConfig(kind=kind, settings=settings))
    gel, moments_s = Gel(GelConfig(), markers), (0.25, 0.5, 0.75, 1.0)
    *_, state = (gel.step(0.05, body, motion.pose(s * motion.duration_s)) for s in moments_s)
    nearer = DISTANCE_MM / (DISTANCE_MM - state.marker_mm[:, 2:])
    axis = GelConfig().grid.axis_mm
    cells = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    touched = np.unpackbits(state.touching_cells)[: len(cells)].astype(bool)
    return state.marker_mm[:, :2] * nearer - markers, cells, touched


def overlap(patch: Patch, cells: np.ndarray, touched: np.ndarray) -> float:
    found = Outline(patch.outline).contains_points(cells)
    return (found & touched).sum() / (found | touched).sum()


@pytest.mark.parametrize("press", PRESSES, ids=lambda press: press[0])
@pytest.mark.parametrize(
    ("markers", "least", "off_mm"),
    [(GRID, 0.75, 0.3), (hexagonal(), 0.55, 0.6)],
    ids=["grid", "shifted rows"],
)
def test_a_press_is_told_where_it_touches(
    press: tuple, markers: np.ndarray, least: float, off_mm: float
) -> None:
    moved, cells, touched = pressed(*press, markers)
    patch = PatchEstimator(markers).patch(moved)
    cell_mm2 = GelConfig().grid.pitch_mm ** 2
    assert overlap(patch, cells, touched) > least
    assert patch.area == pytest.approx(touched.sum() * cell_mm2, rel=1.0 - least)
    np.testing.assert_allclose(patch.place, cells[touched].mean(axis=0), atol=off_mm)


def test_a_camera_that_is_turned_and_counts_in_pixels_sees_the_same() -> None:
    moved, *_ = pressed(*PRESSES[0], GRID)
    told = PatchEstimator(GRID).patch(moved)
    scale, degrees, shift = 15.5, 12.0, np.array([160.0, 150.0])
    other = PatchEstimator(scale * turned(GRID, degrees) + shift).patch(
        scale * turned(moved, degrees)
    )
    assert other.area == pytest.approx(told.area * scale**2, rel=1e-6)
    np.testing.assert_allclose(other.place, scale * turned(told.place, degrees) + shift, atol=1e-6)
    assert len(other.outline) == len(told.outline)


def test_a_lattice_over_a_square_grid_is_its_markers_however_they_are_turned() -> None:
    for degrees in (0.0, 20.0, -44.0):
        lattice = SquareLattice(turned(GRID, degrees) + 5.0)
        assert lattice.weights is None
        np.testing.assert_allclose(lattice.in_image(lattice.places), turned(GRID, degrees) + 5.0)
        steps = lattice.places[:, None] - lattice.places
        np.testing.assert_allclose(steps / PITCH_MM, np.round(steps / PITCH_MM), atol=1e-6)


@pytest.mark.parametrize("markers", [hexagonal(), GRID * [1.0, 1.6]], ids=["shifted", "oblong"])
def test_a_lattice_over_other_markers_reads_linear_fields_exactly(markers: np.ndarray) -> None:
    lattice = SquareLattice(markers)
    assert lattice.weights is not None
    assert len(lattice.places) == pytest.approx(len(markers), rel=0.3)
    slope = np.array([[0.1, -0.3], [0.2, 0.05]])
    read = lattice.field(markers @ slope + 1.0)
    expected = lattice.in_image(lattice.places) @ slope + 1.0
    np.testing.assert_allclose(read, expected @ lattice.rotation, atol=1e-9)
