"""The compiled parts of the published tracker against plain twins."""

from __future__ import annotations

import numpy as np

from spikingtac.markers.hysteresis import PaperLaw, PaperLawConfig

MARKERS = 9


def test_the_law_equals_equations_2_to_5() -> None:
    rng = np.random.default_rng(3)
    reference_px = rng.uniform(0.0, 300.0, (MARKERS, 2))
    path = reference_px + np.cumsum(rng.normal(0.0, 1.5, (40, MARKERS, 2)), axis=0)
    law = PaperLaw(PaperLawConfig(delta_px=4.0, gamma=0.7))
    before, expected = reference_px, reference_px
    inside = 0
    for detected in path:
        distance = np.linalg.norm(detected - reference_px, axis=1)
        gain = np.where(distance >= 4.0, 1.0, 0.7)
        expected = expected + gain[:, np.newaxis] * (detected - before)
        before = detected
        inside += int((distance < 4.0).sum())
        np.testing.assert_allclose(law.update(detected.copy(), reference_px), expected, atol=1e-9)
    assert 0 < inside < path.size // 2
