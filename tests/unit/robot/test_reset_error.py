"""A teleoperated X_real lies along the motion, within what the paper reports."""

import numpy as np
import pytest

from spikingtac.robot.reset_error import ResetErrorConfig, teleoperated_mm


def test_it_errs_along_the_motion_by_what_the_paper_reports() -> None:
    rng = np.random.default_rng(1)
    real, direction = np.array([1.0, 2.0, 3.0]), np.array([0.6, 0.8, 0.0])
    config = ResetErrorConfig()
    found = np.array([teleoperated_mm(real, direction, config, rng) for _ in range(4000)])
    along = (found - real) @ direction
    np.testing.assert_allclose(found, real + np.outer(along, direction), atol=1e-12)
    assert along.std() == pytest.approx(0.17, rel=0.05)
    assert np.quantile(np.abs(along), 0.997) == pytest.approx(0.5, rel=0.1)


def test_none_is_none_and_negative_is_refused() -> None:
    exact = ResetErrorConfig(reset_sigma_mm=0.0, slip_sigma_mm=0.0)
    rng = np.random.default_rng(1)
    assert (teleoperated_mm(np.ones(3), np.ones(3), exact, rng) == 1.0).all()
    with pytest.raises(ValueError, match="negative"):
        ResetErrorConfig(slip_sigma_mm=-0.1)
