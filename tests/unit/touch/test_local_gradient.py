"""The gradient of a displacement field at its markers, against closed forms."""

import numpy as np
import pytest

from spikingtac.touch.field import GradientOperator


def grid(rows: int = 6, columns: int = 7, pitch: float = 37.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns) * pitch, np.arange(rows) * pitch)
    return np.column_stack([x.ravel(), y.ravel()])


def test_an_affine_field_is_exact_at_every_marker() -> None:
    place = grid()
    matrix = np.array([[0.03, 0.02], [-0.05, 0.01]])
    found = GradientOperator(place).of(place @ matrix.T + [3.0, -2.0])
    np.testing.assert_allclose(found.divergence, 0.04, atol=1e-12)
    np.testing.assert_allclose(found.curl, -0.05 - 0.02, atol=1e-12)
    np.testing.assert_allclose(found.stretch, 0.02, atol=1e-12)
    np.testing.assert_allclose(found.skew, -0.05 + 0.02, atol=1e-12)


def test_many_frames_at_once_equal_one_by_one() -> None:
    place, rng = grid(), np.random.default_rng(1)
    frames = rng.normal(size=(5, len(place), 2))
    operator = GradientOperator(place)
    together = operator.of(frames).divergence
    alone = np.stack([operator.of(frame).divergence for frame in frames])
    np.testing.assert_allclose(together, alone)


def test_the_strength_of_noise_is_as_foretold() -> None:
    place, rng = grid(), np.random.default_rng(2)
    operator = GradientOperator(place)
    strengths = operator.of(rng.normal(size=(2000, len(place), 2))).strength
    assert np.sqrt((strengths**2).mean()) == pytest.approx(operator.noise_gain(), rel=0.03)
