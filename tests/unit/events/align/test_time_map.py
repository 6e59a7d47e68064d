"""Maps between clocks that drift, jitter and lie: found within the error that they state."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.clock import TimeMap, through_moments
from spikingtac.events.delivery import ClockFit


def watched(drift_ppm: float, start_s: float, seed: int, seconds: float = 120.0) -> TimeMap:
    """A host hears every 4 ms of a clock that began at ``start_s``; transport is 0.2 ms or more."""
    rng, fit = np.random.default_rng(seed), ClockFit()
    for own_s in np.arange(0.0, seconds, 0.004):
        late_s = 2e-4 + rng.exponential(1e-3)
        fit.arrived(round(own_s * 1e6), start_s + own_s * (1.0 + drift_ppm * 1e-6) + late_s)
    mapping = fit.mapping()
    assert mapping is not None
    return mapping


@pytest.mark.parametrize("seed", range(4))
def test_two_clocks_meet_at_their_host_within_five_errors(seed: int) -> None:
    own, base = watched(40.0, 1_003.5, seed), watched(-25.0, 1_000.0, seed + 100)
    found = own.then(base.inverse())
    assert found.drift_error_ppm is not None
    true_drift_ppm = ((1 + 40e-6) / (1 - 25e-6) - 1) * 1e6
    assert abs(found.drift_ppm - true_drift_ppm) < 5.0 * found.drift_error_ppm
    for own_s in (0.0, 60.0, 120.0):
        host_s = 1_003.5 + own_s * (1 + 40e-6)
        truth_us = (host_s - 1_000.0) / (1 - 25e-6) * 1e6
        error_us = abs(found(np.array([round(own_s * 1e6)]))[0] - truth_us)
        assert error_us < 5.0 * found.error_at_us(own_s * 1e6) + 1.0
        assert found.error_at_us(own_s * 1e6) < 100.0


def test_there_and_back_and_through_a_document() -> None:
    found = TimeMap(own_us=5e8, base_us=1.7e15, drift_ppm=33.0, error_us=7.0, drift_error_ppm=0.2)
    t_us = np.arange(0, 10**9, 10**7)
    assert np.abs(found.inverse()(found(t_us)) - t_us).max() <= 1
    assert TimeMap.from_document(found.summary()) == found
    assert (np.diff(found(np.arange(0, 10**6, 7))) >= 0).all()
    for broken in (
        {},
        {**found.summary(), "base_us": "soon"},
        {**found.summary(), "own_us": 1e999},
    ):
        with pytest.raises(RecordingError, match="time_base"):
            TimeMap.from_document(broken)


@pytest.mark.parametrize("seed", range(5))
def test_taps_give_offset_and_drift_and_mistaken_ones_are_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own_us = np.sort(rng.integers(0, 300_000_000, 40)).astype(float)
    base_us = 1e6 + own_us * (1 + 60e-6) + rng.normal(0.0, 300.0, 40)
    base_us[rng.integers(0, 40, 6)] += 40_000.0
    found = through_moments(own_us, base_us)
    assert found.drift_error_ppm is not None
    assert abs(found.drift_ppm - 60.0) < 5.0 * found.drift_error_ppm
    truth_us = 1e6 + found.own_us * (1 + 60e-6)
    assert abs(found.base_us - truth_us) < 5.0 * found.error_us
    assert 10.0 < found.error_us < 200.0


def test_one_tap_gives_an_offset_and_claims_no_drift() -> None:
    found = through_moments(np.array([1_000_000]), np.array([1_250_000]), floor_us=100.0)
    assert (found.drift_ppm, found.drift_error_ppm, found.error_us) == (0.0, None, 100.0)
    assert found(np.array([2_000_000]))[0] == 2_250_000
    for wrong in ((np.array([]), np.array([])), (np.array([1]), np.array([1, 2]))):
        with pytest.raises(ConfigError, match="at least one"):
            through_moments(*wrong)
