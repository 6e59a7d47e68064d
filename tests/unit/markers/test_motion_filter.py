from __future__ import annotations

import numpy as np

from spikingtac.markers.motion_filter import (
    ACCELERATION_NOISE_PX2_S3,
    MEASUREMENT_SIGMA_PX,
    START_VELOCITY_PX_S,
    MotionFilter,
)


def naive_filter(positions: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the textbook Kalman filter's states of one axis, by matrices."""
    state = np.array([positions[0], 0.0])
    cov = np.diag([MEASUREMENT_SIGMA_PX**2, START_VELOCITY_PX_S**2])
    f = np.array([[1.0, dt], [0.0, 1.0]])
    q = ACCELERATION_NOISE_PX2_S3 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    out = []
    for z in positions:
        state, cov = f @ state, f @ cov @ f.T + q
        gain = cov[:, 0] / (cov[0, 0] + MEASUREMENT_SIGMA_PX**2)
        state = state + gain * (z - state[0])
        cov = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ cov
        out.append(state)
    return np.array(out)[:, 0], np.array(out)[:, 1]


def test_equals_the_textbook() -> None:
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0.0, 0.3, (60, 4, 2)), axis=0)
    kalman = MotionFilter(path[0])
    positions, velocities = [], []
    nobody = np.zeros(4, bool)
    for measured in path:
        kalman.predict(1e-3)
        kalman.update(measured, nobody)
        positions.append(kalman.position_px.copy())
        velocities.append(kalman.velocity_px_s.copy())
    for m in range(4):
        for axis in range(2):
            position, velocity = naive_filter(path[:, m, axis], 1e-3)
            np.testing.assert_allclose(np.array(positions)[:, m, axis], position, rtol=1e-9)
            np.testing.assert_allclose(np.array(velocities)[:, m, axis], velocity, rtol=1e-9)


def test_steady_motion_is_followed_without_lag() -> None:
    kalman = MotionFilter(np.zeros((1, 2)))
    for k in range(400):
        kalman.predict(1e-3)
        kalman.update(np.array([[0.2 * k, -0.1 * k]]), np.zeros(1, bool))
    np.testing.assert_allclose(kalman.position_px, [[0.2 * 399, -0.1 * 399]], atol=1e-6)
    np.testing.assert_allclose(kalman.velocity_px_s, [[200.0, -100.0]], atol=1e-3)


def test_held_markers_stay_and_placed_ones_jump() -> None:
    kalman = MotionFilter(np.zeros((2, 2)))
    held = np.array([True, False])
    for k in range(20):
        kalman.predict(1e-3)
        kalman.update(np.full((2, 2), float(k)), held)
    np.testing.assert_array_equal(kalman.position_px[0], 0.0)
    assert kalman.position_px[1, 0] > 15.0
    kalman.place(held, np.array([[5.0, 6.0]]))
    np.testing.assert_array_equal(kalman.position_px[0], [5.0, 6.0])


def test_a_marker_that_is_coasted_loses_its_speed() -> None:
    """It is put where its neighbours expect it; its own last speed would carry it away."""
    kalman = MotionFilter(np.zeros((2, 2)))
    coasted = np.zeros(2, bool)
    for k in range(40):
        coasted[0] = k >= 20
        kalman.predict(1e-3)
        kalman.update(np.full((2, 2), 0.3 * k), coasted)
        if k == 20:
            lost_px = kalman.position_px[0].copy()
    np.testing.assert_array_equal(kalman.velocity_px_s[0], 0.0)
    np.testing.assert_array_equal(kalman.position_px[0], lost_px)
    np.testing.assert_allclose(kalman.velocity_px_s[1], 300.0, rtol=0.01)


def test_faster_estimates_smooth_as_much_per_ms() -> None:
    rng = np.random.default_rng(1)
    scatter = []
    for repeats in (1, 10):
        kalman = MotionFilter(np.zeros((500, 2)))
        for _ in range(60):
            measured = rng.normal(0.0, 0.05, (500, 2))
            for _ in range(repeats):  # the map is read ten times before it changes
                kalman.predict(1e-3 / repeats)
                kalman.update(measured, np.zeros(500, bool))
        scatter.append(kalman.position_px.std())
    assert 0.8 < scatter[1] / scatter[0] < 1.25
