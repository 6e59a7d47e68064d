"""The wrench of one field against the sums over many, for every law that there is."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.force.laws import FAMILIES, LawChoice, fit_component
from spikingtac.touch.force.novelty import learn_novelty
from spikingtac.touch.force.shape import FieldBasis, FieldFeatures
from spikingtac.touch.force.stacked_laws import StackedLaws

Array = np.ndarray


def drawn(dimensions: int, frames: int = 300, markers: int = 30) -> tuple[Array, Array]:
    """Return smooth fields of some size, and a force that they could stand for."""
    rng = np.random.default_rng(dimensions)
    patterns = rng.normal(size=(6, markers * dimensions))
    loads = rng.normal(size=(frames, 6)) * rng.uniform(0.0, 2.0, (frames, 1))
    fields = loads @ patterns + 0.05 * rng.normal(size=(frames, markers * dimensions))
    return fields, -(np.abs(loads).sum(axis=1) ** 1.5)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "correction"])
@pytest.mark.parametrize("corrected", [False, True])
def test_one_field_tells_what_many_do(dimensions: int, family: str, corrected: bool) -> None:
    fields, force = drawn(dimensions)
    basis = FieldBasis.learn(fields, dimensions)
    features = FieldFeatures(fields, basis)
    laws = [fit_component(LawChoice((family,), corrected), features, force)]  # type: ignore[arg-type]
    laws.append(fit_component(LawChoice(("shape", "squares")), features, fields[:, 0]))
    stacked, novelty = StackedLaws(laws, basis), learn_novelty(fields, basis.modes)
    one = stacked.one_field(basis, novelty)
    other = np.vstack([1.3 * fields[:40] + 0.1, 0.0 * fields[:1], 50.0 * fields[:3]])
    expected, distance = stacked(FieldFeatures(other, basis)), novelty(other, basis.modes)
    for row, field in enumerate(other):
        values, away = one(field)
        np.testing.assert_allclose(values, expected[row], rtol=1e-9, atol=1e-9)
        assert away == pytest.approx(distance[row], rel=1e-12)
