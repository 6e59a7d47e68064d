"""Steps grow where the tracker lags, and stay where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.markers.calibration.trial_tracking import fit_step_scale
from stand_ins.swaying_discs import (
    PERIOD_US,
    REST_PX,
    SAMPLES,
    STEP,
    calibration,
    swaying_discs,
    ways_px,
)


@pytest.fixture(scope="module")
def events() -> BufferedEvents:
    return swaying_discs()


def known_places(events: BufferedEvents) -> tuple[np.ndarray, np.ndarray]:
    samples = np.arange(50, SAMPLES, 50)
    index = events.index_at(samples * PERIOD_US)
    return index, REST_PX + ways_px()[samples][:, np.newaxis]


def test_right_steps_stay(events: BufferedEvents) -> None:
    on, off = fit_step_scale(events, calibration(STEP), known_places(events))
    assert max(on, off) < 1.3


def test_small_steps_grow(events: BufferedEvents) -> None:
    on, off = fit_step_scale(events, calibration(STEP / 2.5), known_places(events))
    assert min(on, off) > 1.5


def test_markers_that_were_not_measured_do_not_count(events: BufferedEvents) -> None:
    index, places_px = known_places(events)
    wrong_px = places_px.copy()
    wrong_px[:, 3] += 30.0
    measured = replace(calibration(STEP), marker_measured=np.arange(4) < 3)
    assert fit_step_scale(events, measured, (index, wrong_px)) == fit_step_scale(
        events, measured, (index, places_px)
    )


def test_every_kind_of_step_is_scaled_up_to_one() -> None:
    maps = np.array([[0.0, 0.3], [0.6, 0.9]], np.float32)
    own = replace(
        calibration(0.2),
        step_on_map=maps,
        step_off_map=maps,
        marker_step_on=np.full(4, 0.25),
        marker_step_off=np.full(4, 0.5),
    )
    scaled = own.with_steps_scaled(2.0, 1.0)
    assert (scaled.step_on, scaled.step_off) == (0.4, 0.2)
    assert scaled.step_on_map is not None
    assert scaled.marker_step_on is not None
    np.testing.assert_allclose(scaled.step_on_map, [[0.0, 0.6], [1.0, 1.0]])
    np.testing.assert_allclose(scaled.marker_step_on, 0.5)
    assert scaled.step_off_map is not None
    assert scaled.marker_step_off is not None
    np.testing.assert_allclose(scaled.step_off_map, maps)
    np.testing.assert_allclose(scaled.marker_step_off, 0.5)
