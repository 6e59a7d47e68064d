"""The lag on a recording of an independent simulator whose best constant lag is 2.6 ms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.open import open_events
from spikingtac.markers.crossings import marker_track, observe_crossings
from spikingtac.markers.lag import estimate_lag, slide_lag_us

LAG_US = 2_600.0

# As the recording was made; a calibration finds them.
EDGE = DiscProfile(170 / 28, 0.55)


def test_the_bootstraps_lag_is_found(data_dir: Path) -> None:
    """The track is the truth, late by 2.6 ms, as a disc fit's; the estimator sees only that."""
    truth = np.load(data_dir / "v2e" / "bootstrap.truth.npz")
    true_us, path = truth["marker_t_us"], truth["marker_px"].astype(np.float64)
    t_us = np.arange(true_us[0] + 10_000, true_us[-1], 1_000)
    flat = path.reshape(len(path), -1)
    late = [np.interp(t_us - LAG_US, true_us, column) for column in flat.T]
    places = np.stack(late, axis=1).reshape(-1, *path.shape[1:])
    track = marker_track(t_us, places, truth["radius_px"])
    source = open_events(data_dir / "v2e" / "bootstrap.raw")
    estimate = estimate_lag(observe_crossings(source, track, source.size), EDGE)
    assert estimate is not None
    print(
        f"bootstrap.raw: lag {estimate.lag_us:.0f} +- {estimate.uncertainty_us:.0f} us "
        f"(track late by {LAG_US:.0f} us) from {estimate.samples} events"
    )
    assert estimate.lag_us == pytest.approx(LAG_US, rel=0.25)
    assert abs(estimate.lag_us - LAG_US) < 2.5 * estimate.uncertainty_us
    assert estimate.uncertainty_us < 0.25 * LAG_US


def test_the_disc_fits_lag_is_found(data_dir: Path) -> None:
    """The tracker's positions, not the truth's; what they cost is judged against the truth."""
    truth = np.load(data_dir / "v2e" / "bootstrap.truth.npz")
    calibration = Calibration(
        reference_px=truth["reference_px"].astype(np.float64),
        radius_px=truth["radius_px"].astype(np.float64),
        grid=(8, 8),
        size=(320, 320),
        step_on=1 / 7.4,
        step_off=1 / 7.2,
        contrast=EDGE.contrast,
        edge_px=EDGE.edge_px,
    )
    lag_us = slide_lag_us(open_events(data_dir / "v2e" / "bootstrap.raw"), calibration)
    print(f"bootstrap.raw, disc fit: {lag_us} us")
    assert lag_us == pytest.approx(LAG_US, rel=0.25)
