"""The strength of a field's gradient against the gradients themselves."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.field import GradientOperator


@pytest.mark.parametrize("shape", [(8, 8), (2, 2), (3, 5)])
def test_the_strength_is_that_of_the_gradients(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[0])
    x, y = np.meshgrid(np.arange(shape[1]) * 37.0, np.arange(shape[0]) * 37.0)
    reference = np.column_stack([x.ravel(), y.ravel()]) + rng.normal(0.0, 1.0, (x.size, 2))
    operator = GradientOperator(reference)
    for scale in (0.0, 1e-6, 5.0):
        moved = scale * rng.normal(size=reference.shape)
        gradients = operator.of(moved)
        strength = operator.strength_of(moved)
        assert strength == pytest.approx(float(gradients.strength), rel=1e-11)
