from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.errors import ConfigError


def test_level_is_the_normalised_logarithm_of_a_blurred_disc() -> None:
    profile = DiscProfile(contrast=5.0, edge_px=0.7)
    q = np.linspace(-4.0, 4.0, 33)
    intensity = 1.0 + 4.0 / (1.0 + np.exp(q / 0.7))
    np.testing.assert_allclose(profile.level(q), np.log(intensity) / np.log(5.0), atol=1e-12)


def test_slope_is_the_derivative() -> None:
    profile = DiscProfile(contrast=8.0, edge_px=0.5)
    q, h = np.linspace(-3.0, 3.0, 25), 1e-6
    numeric = (profile.level(q + h) - profile.level(q - h)) / (2 * h)
    np.testing.assert_allclose(profile.slope(q), numeric, atol=1e-6)


@pytest.mark.parametrize(("contrast", "edge"), [(1.0, 0.5), (0.3, 0.5), (6.0, 0.0)])
def test_unfit_values_are_refused(contrast: float, edge: float) -> None:
    with pytest.raises(ConfigError):
        DiscProfile(contrast, edge)
