"""When a marker is fitted, and the Kalman filter that follows it."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.markers.graded.appearance import DEAD_US, painted_levels
from spikingtac.markers.graded.disc_locator import FAST_DEAD_TIMES, LEAST_SEEN, DiscLocator
from spikingtac.markers.graded.motion import (
    ACCELERATION_NOISE_PX2_S3,
    FIT_NOW,
    GATE_PX,
    MAX_WAIT_US,
    MEASUREMENT_SIGMA_PX,
    MISSED_PX,
    REASSIGN_PX,
    START_VELOCITY_PX_S,
    correct_kernel,
    predict_kernel,
    resting_markers,
)
from spikingtac.types import EventPacket
from stand_ins.known import known

REST_PX = np.array([[30.0, 30.0], [70.0, 30.0]])
CALIBRATION = known(REST_PX, 7.0, (100, 60), (1, 2))


def moved_by(shift_px: float, dead_us: float | None = None) -> DiscLocator:
    """Return a locator whose map shows the discs elsewhere; it has made its first estimate."""
    locator = DiscLocator(replace(CALIBRATION, dead_time_us=dead_us))
    elsewhere = replace(CALIBRATION, reference_px=REST_PX + np.array([shift_px, 0.0]))
    locator.map.values[:], _ = painted_levels(elsewhere)
    locator.locate(0, np.zeros(2, np.bool_))
    return locator


@pytest.mark.parametrize("radius_px", [2.0, 7.0, 23.0, 60.0, 90.0])
def test_discs_of_every_size_are_fitted(radius_px: float) -> None:
    """Markers of 0.6 to 28 % of the width of a 1280x720 sensor; one lies at its border."""
    sensor = known(np.array([[640.0, 360.0], [20.0, 700.0]]), radius_px, (1280, 720), (1, 2))
    locator = DiscLocator(sensor)
    locator.markers["x"] += 0.8
    locator.pending[:] = FIT_NOW
    locator.locate(0, np.zeros(2, np.bool_))
    np.testing.assert_allclose(locator.markers["fit_x"], sensor.reference_px[:, 0], atol=0.05)
    assert locator.markers["agreement"][0] > 0.95


def naive_filter(positions: np.ndarray, dt: float, sigma: float) -> tuple[np.ndarray, ...]:
    """Return the textbook Kalman filter's states of one axis, by matrices."""
    state = np.array([positions[0], 0.0])
    cov = np.diag([MEASUREMENT_SIGMA_PX**2, START_VELOCITY_PX_S**2])
    f = np.array([[1.0, dt], [0.0, 1.0]])
    q = ACCELERATION_NOISE_PX2_S3 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    out = []
    for z in positions:
        state, cov = f @ state, f @ cov @ f.T + q
        gain = cov[:, 0] / (cov[0, 0] + sigma**2)
        state = state + gain * (z - state[0])
        cov = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ cov
        out.append(state)
    return np.array(out)[:, 0], np.array(out)[:, 1]


@pytest.mark.parametrize(("dt", "spread"), [(1e-3, 1.0), (1e-4, np.sqrt(10.0))])
def test_the_filter_equals_the_textbook(dt: float, spread: float) -> None:
    """Estimates that are made more often read nearly the same map: each tells less."""
    path = np.cumsum(np.random.default_rng(0).normal(0.0, 0.3, (60, 2)), axis=0)
    marker, states = resting_markers(path[:1])[0], []
    for x, y in path:
        predict_kernel(marker, dt)
        correct_kernel(marker, x, y, dt)
        states.append(marker.copy())
    for axis, measured in zip("xy", path.T, strict=True):
        place, speed = naive_filter(measured, dt, MEASUREMENT_SIGMA_PX * spread)
        np.testing.assert_allclose(np.array(states)[axis], place, rtol=1e-8)
        np.testing.assert_allclose(np.array(states)["v" + axis], speed, rtol=1e-8)


def test_a_lost_marker_stands_still() -> None:
    locator = moved_by(0.0)
    locator.markers["vx"] = 100.0
    for t_us in (1_000, 2_000, 50_000):
        locator.locate(t_us, np.array([True, False]))
    assert locator.markers["vx"][0] == 0.0
    assert locator.markers["x"][0] == pytest.approx(30.1)


def test_a_fit_waits_for_its_events_or_for_some_ms() -> None:
    locator, nobody = moved_by(0.5), np.zeros(2, np.bool_)
    locator.pending[:] = 3, 4, 0
    locator.locate(1_000, nobody)
    assert locator.markers["fit_x"][1] == pytest.approx(70.5, abs=0.05)
    locator.locate(MAX_WAIT_US - 500, nobody)
    assert locator.markers["fit_x"][0] == 30.0, "three events are not enough"
    assert locator.pending.tolist() == [3, 0, 0]
    locator.locate(MAX_WAIT_US, nobody)
    assert locator.markers["fit_x"][0] == pytest.approx(30.5, abs=0.05)


def test_markers_take_turns_and_one_that_its_prediction_missed_takes_more() -> None:
    locator, nobody, fitted = DiscLocator(CALIBRATION), np.zeros(2, np.bool_), []
    for t_us in range(0, 6_000, 500):
        locator.pending[:] = 5
        locator.locate(t_us, nobody)
        fitted.append((locator.markers["fit_us"] == t_us).tolist())
    turns = np.array(fitted[1:])  # at 0 both begin
    assert turns.sum(axis=0).tolist() == [2, 3], "each once in 2 ms"
    assert not turns.all(axis=1).any(), "not at one time"
    for k, t_us in enumerate((6_200, 6_600, 7_600, 7_900)):  # a miss, then a sudden motion
        locator.markers["innovation_px"][1] = MISSED_PX * (k < 2)
        locator.pending[:] = 5, (5, 999)[k // 2], 0
        locator.locate(t_us, nobody)
        assert (locator.markers["fit_us"] == t_us).tolist() == [k == 0, k in (1, 2)], "once in 1 ms"
    locator.pending[0] = FIT_NOW
    locator.locate(7_950, nobody)
    assert locator.markers["fit_us"][0] == 7_950


def test_without_events_nothing_is_fitted_and_a_speed_fades() -> None:
    locator, nobody = moved_by(0.5), np.zeros(2, np.bool_)
    locator.markers["vx"] = 50.0
    for t_us in range(1_000, 40_000, 1_000):
        locator.locate(t_us, nobody)
    np.testing.assert_array_equal(locator.markers["fit_x"], REST_PX[:, 0])
    np.testing.assert_allclose(locator.markers["x"], REST_PX[:, 0], atol=0.01)
    assert np.abs(locator.markers["vx"]).max() < 1.0


def test_events_count_for_the_marker_around_which_they_lie_also_far_from_its_rest() -> None:
    locator, nobody = moved_by(0.0), np.zeros(2, np.bool_)
    locator.pending[:] = 0
    locator.markers["x"][0] += 18.0  # beyond the middle between the two
    locator.markers["vx"] = 1.0
    locator.locate(2_000, nobody)
    columns = np.array([30, 37, 55, 48, 77, 70], np.uint16)
    events = columns, np.full(6, 30, np.uint16), np.ones(6, np.bool_), np.arange(6)
    locator.absorb(EventPacket(*events, 0, 6, (100, 60)))
    assert locator.pending.tolist() == [2, 2, 2], "not what it left"
    assert locator.event_count.tolist() == [2, 2, 2]
    locator.place(np.array([True, False]), REST_PX)
    locator.locate(4_000, nobody)
    assert locator.event_count.tolist() == [2, 2, 2], "also of a marker that was put somewhere"


@pytest.mark.parametrize("dead_us", [None, 0.0, 500.0])
def test_the_map_and_the_counts_are_those_of_the_plain_twin(dead_us: float | None) -> None:
    locator, rng = moved_by(0.0, dead_us), np.random.default_rng(4)
    blind_us = DEAD_US if dead_us is None else dead_us
    twin, marked = deepcopy(locator.map), locator.map.pixels["marker"]
    x, y, p = rng.integers(0, 100, 6_000), rng.integers(0, 60, 6_000), rng.random(6_000) < 0.5
    t = np.sort(rng.integers(0, 9_000, 6_000))
    packet = EventPacket(x.astype(np.uint16), y.astype(np.uint16), p, t, 0, 9_000, (100, 60))
    locator.pending[:] = 0
    locator.absorb(packet)
    last: dict[tuple[int, int], tuple[int, bool]] = {}
    for i in range(len(packet)):
        place, event = (int(x[i]), int(y[i])), (int(t[i]), bool(p[i]))
        before_us, rose = last.get(place, event)
        since_us = event[0] - before_us
        follows = rose == event[1] and 0 < since_us < FAST_DEAD_TIMES * blind_us
        share = max((since_us - blind_us) / since_us, LEAST_SEEN) if follows else 1.0
        twin.arrival_ratio, last[place] = share, event
        twin.absorb(packet.select(np.array([i])))
    np.testing.assert_array_equal(locator.map.padded, twin.padded)
    away_px = np.hypot(*(np.column_stack([x, y])[:, np.newaxis] - REST_PX).transpose(2, 0, 1))
    near = away_px <= 7.0 + locator.window.edge[0, 1] + GATE_PX + REASSIGN_PX
    assert locator.pending.tolist() == [*near.sum(axis=0), (~near.any(axis=1)).sum()]
    assert {*np.unique(marked).tolist()} == {0, 1, 2}


def test_a_held_marker_stays_where_it_is_put_and_loses_its_speed() -> None:
    locator, held = moved_by(0.5), np.array([True, False])
    locator.markers["vx"] = 300.0
    locator.place(held, REST_PX + 2.0)
    for t_us in range(1_000, 4_000, 1_000):
        locator.pending[1] = 4
        locator.locate(t_us, held)
    assert locator.markers[["x", "y", "vx", "vy"]][0].tolist() == (32.0, 32.0, 0.0, 0.0)
    assert locator.markers["x"][1] == pytest.approx(70.5, abs=0.2)


def test_a_leap_of_the_clock_moves_no_marker() -> None:
    locator, nobody = moved_by(0.0), np.zeros(2, np.bool_)
    locator.markers["vx"] = 100.0
    for t_us in (3_600_000_000, 3_600_001_000):
        locator.pending[:2] |= FIT_NOW
        locator.locate(t_us, nobody)
    np.testing.assert_allclose(locator.markers["x"], REST_PX[:, 0], atol=0.2)
