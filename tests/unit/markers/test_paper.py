from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.classical import Median3, NoDenoiser
from spikingtac.markers.paper import BlobTracker, BlobTrackerConfig, painted_binary_map
from spikingtac.types import EventPacket
from stand_ins.known import known

SIZE = (150, 120)
GRID = (3, 4)
RADIUS_PX = 6.0
REST_PX = np.stack(np.meshgrid(np.arange(20, 140, 33.0), np.arange(20, 110, 33.0)), -1)
REST_PX = REST_PX.reshape(-1, 2)
PLAIN = BlobTrackerConfig(support_us=0, refresh_us=0)


def calibration() -> Calibration:
    return known(REST_PX, RADIUS_PX, SIZE, GRID)


def test_a_vanished_marker_is_held_and_comes_back() -> None:
    state_map = painted_binary_map(calibration())
    follower = BlobTracker(PLAIN, calibration(), NoDenoiser(), state_map)
    before = follower.estimate(0)
    kept = state_map.values[8:33, 8:33].copy()
    state_map.values[8:33, 8:33] = 0.0
    gone = follower.estimate(1)
    assert np.flatnonzero(gone.coasted).tolist() == [0]
    assert gone.confidence[0] == 0.0
    np.testing.assert_array_equal(gone.detected_px, before.detected_px)
    state_map.values[8:33, 11:36] = kept
    back = follower.estimate(2)
    assert not back.coasted.any()
    np.testing.assert_allclose(back.detected_px[0], before.detected_px[0] + [3.0, 0.0])


def test_half_a_marker_is_held_rather_than_followed() -> None:
    state_map = painted_binary_map(calibration())
    follower = BlobTracker(PLAIN, calibration(), NoDenoiser(), state_map)
    state_map.values[8:20, 8:33] = 0.0  # more than half of marker 0
    state_map.values[20, 8:33] = 0.0
    assert follower.estimate(0).coasted[0]


def test_one_blob_never_serves_two_markers() -> None:
    state_map = painted_binary_map(calibration())
    follower = BlobTracker(PLAIN, calibration(), NoDenoiser(), state_map)
    state_map.values[10:31, 10:64] = 0.0
    state_map.values[15:26, 30:41] = 1.0  # one blob between markers 0 and 1, nearer to 0
    frame = follower.estimate(0)
    assert frame.coasted.tolist() == [False, True] + [False] * 10


def test_a_refreshed_map_forgets_its_noise_and_no_marker() -> None:
    config = BlobTrackerConfig(support_us=0, refresh_us=1_000)
    state_map = painted_binary_map(calibration())
    follower = BlobTracker(config, calibration(), Median3(), state_map)
    follower.estimate(0)
    noise = np.random.default_rng(0).random(state_map.values.shape) < 0.05
    state_map.values[noise] = 1.0 - state_map.values[noise]
    follower.estimate(999)
    assert np.count_nonzero(state_map.values != painted_binary_map(calibration()).values) > 500
    follower.estimate(1_000)
    left = np.count_nonzero(state_map.values != painted_binary_map(calibration()).values)
    assert left < 0.1 * np.count_nonzero(noise)
    assert set(np.unique(state_map.values)) == {0.0, 1.0}


@pytest.mark.parametrize("values", [{"threshold": 0.0}, {"support_us": -1}, {"refresh_us": -1}])
def test_unfit_settings_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        BlobTrackerConfig(**values)


@pytest.mark.parametrize(("off", "adapted"), [(0.15, False), (0.42, True)])
def test_where_off_events_are_rare_the_filter_waits_for_them(off: float, adapted: bool) -> None:
    """OFF events that are 15 ms apart erase a disc there, and only there."""
    sensor = replace(calibration(), step_on=0.15, step_off=off)
    follower = BlobTracker(BlobTrackerConfig(), sensor, NoDenoiser())
    x, y = (int(value) for value in sensor.reference_px[0])
    before = int((follower.state_map.values > 0.5).sum())
    columns = np.arange(x - 2, x + 3, dtype=np.uint16)
    times_us = 15_000 * np.arange(5, dtype=np.int64)
    packet = EventPacket(
        columns, np.full(5, y, np.uint16), np.zeros(5, np.bool_), times_us, 0, 75_000, sensor.size
    )
    follower.absorb(packet)
    erased = before - int((follower.state_map.values > 0.5).sum())
    assert erased == (4 if adapted else 0), "the first of them has no company"
