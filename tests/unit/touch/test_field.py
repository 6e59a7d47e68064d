"""The gradient of a displacement field and the quantities of the whole, against closed forms."""

import numpy as np
import pytest

from spikingtac.touch.field import EVERY, FieldGauge, GradientOperator, LostMarkers
from spikingtac.touch.onset import STRING_PX, UNSEEN_LATER_PX, UNSEEN_REVERSED_PX, unseen_px

MARKERS = 64


def grid(rows: int, columns: int) -> np.ndarray:
    row, column = np.divmod(np.arange(rows * columns), columns)
    return 37.0 * np.column_stack([column, row])


REFERENCE = grid(8, 8)


def test_an_affine_field_is_exact_at_every_marker() -> None:
    place = grid(6, 7)
    matrix = np.array([[0.03, 0.02], [-0.05, 0.01]])
    found = GradientOperator(place).slopes(place @ matrix.T + [3.0, -2.0])
    np.testing.assert_allclose(found, np.broadcast_to(matrix.T, found.shape), atol=1e-12)


@pytest.mark.parametrize("shape", [(8, 8), (2, 2), (3, 5)])
def test_the_strength_is_that_of_the_gradients(shape: tuple[int, int]) -> None:
    rng, place = np.random.default_rng(shape[0]), grid(*shape)
    operator = GradientOperator(place + rng.normal(0.0, 1.0, place.shape))
    for scale in (0.0, 1e-6, 5.0):
        moved = scale * rng.normal(size=place.shape)
        (x_by_x, y_by_x), (x_by_y, y_by_y) = np.moveaxis(operator.slopes(moved), 0, -1)
        parts = (x_by_x + y_by_y, y_by_x - x_by_y, x_by_x - y_by_y, x_by_y + y_by_x)
        told = np.sqrt(sum((part**2).mean() for part in parts))
        assert operator.strength_of(moved) == pytest.approx(told, rel=1e-11)


def test_quantities_of_a_known_field() -> None:
    away = REFERENCE - REFERENCE.mean(axis=0)
    moved = 0.02 * away + 0.01 * away @ [[0.0, 1.0], [-1.0, 0.0]] + [3.0, -1.0]
    found = FieldGauge(REFERENCE, 0.1).measure(moved)
    assert found.mean_shear_x_px.value == pytest.approx(3.0)
    assert found.mean_shear_y_px.value == pytest.approx(-1.0)
    assert found.torsion_rad.value == pytest.approx(np.arctan2(0.01, 1.02))
    assert found.divergence.value == pytest.approx(0.04)
    assert found.curl.value == pytest.approx(0.02)


@pytest.mark.parametrize("stretch", [0.0, 0.005, 0.05])
def test_their_uncertainty_is_that_of_repeated_noise_which_is_taken_off_the_strain(
    stretch: float,
) -> None:
    rng, gauge = np.random.default_rng(5), FieldGauge(REFERENCE, 0.2)
    moved = stretch * (REFERENCE - REFERENCE.mean(axis=0)) * [1.0, 0.0]
    found = [gauge.measure(moved + rng.normal(0.0, 0.2, (MARKERS, 2))) for _ in range(400)]
    for name in ("mean_shear_x_px", "torsion_rad", "divergence", "curl", "strain"):
        values = np.array([getattr(one, name).value for one in found])
        told = np.mean([getattr(one, name).sigma for one in found])
        assert values.std() == pytest.approx(told, rel=0.15), name
    if stretch:
        strain = np.mean([one.strain.value for one in found])
        exact = GradientOperator(REFERENCE).strength_of(moved)
        assert strain == pytest.approx(exact, rel=0.02)


def press(depth: float) -> np.ndarray:
    away = (REFERENCE - REFERENCE.mean(axis=0)) / 37.0
    return depth * away * np.exp(-0.25 * (away**2).sum(axis=1, keepdims=True))


def test_a_lost_marker_takes_its_neighbours_displacement() -> None:
    moved = press(0.2)
    wrong = moved.copy()
    wrong[[19, 27]] += (7.0, 0.0)
    repaired = LostMarkers(REFERENCE).repaired(wrong)
    np.testing.assert_allclose(repaired, moved, atol=0.3)
    kept = np.delete(np.arange(64), [19, 27])
    np.testing.assert_array_equal(repaired[kept], wrong[kept])


def test_a_lost_marker_is_believed_again_only_when_it_is_well_back() -> None:
    lost, moved = LostMarkers(REFERENCE), np.zeros((64, 2))
    for moved[20, 1], believed in ((7.0, False), (1.0, False), (0.3, True), (1.0, True)):
        for _ in range(EVERY):
            lost.repaired(moved)
        assert lost.lost[20] != believed


def test_more_is_unseen_after_a_reversal() -> None:
    string = np.full((4, 2), (STRING_PX, 0.0))
    onward, back = np.full((4, 2), (1.0, 0.0)), np.full((4, 2), (-1.0, 0.0))
    assert unseen_px(string, onward) == pytest.approx(UNSEEN_LATER_PX)
    assert unseen_px(string, back) == pytest.approx(UNSEEN_LATER_PX + UNSEEN_REVERSED_PX)
    assert unseen_px(0 * string, back) == 0.0
