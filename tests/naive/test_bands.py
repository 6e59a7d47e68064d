"""The band map and the band fit against plain twins."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.config import load_config
from spikingtac.markers.graded.appearance import profile_tables
from spikingtac.markers.graded.bands import (
    MODEL_VARIANCE,
    SOFT_RESIDUAL,
    correct_levels_kernel,
    normal_equations_kernel,
    solve_kernel,
)
from spikingtac.markers.registry import MarkerTracker, make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket
from stand_ins.rare_off import (
    PERIOD_US,
    PROFILE,
    RADIUS_PX,
    REST_PX,
    SIZE,
    STEP_OFF,
    STEP_ON,
    levels,
    presses_px,
    rare_off_calibration,
    rare_off_events,
)

TURN = 7


def random_maps(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    shape = (SIZE[1], SIZE[0])
    memory = (levels(REST_PX) + rng.normal(0.0, 0.2, shape)).astype(np.float32)
    variance = rng.uniform(0.001, 0.05, shape).astype(np.float32)
    fired = np.where(rng.random(shape) < 0.3, TURN, 0)
    steps = np.stack([np.full(shape, -STEP_OFF), np.full(shape, STEP_ON)], axis=-1)
    padded = GradedStateMap(memory.clip(0.0, 1.0)).padded
    return memory, variance, fired, steps.astype(np.float32), TURN, padded


def residuals(maps: tuple[np.ndarray, ...], x: float, y: float) -> tuple[np.ndarray, ...]:
    """Return residual, slope, direction and membership of every pixel, from the formulas alone."""
    memory, _, fired, _, turn, _ = maps
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    dx, dy = column - x, row - y
    rho = np.hypot(dx, dy) + 1e-9
    q = rho - RADIUS_PX
    apart = memory - PROFILE.level(q)
    outside = np.where(apart > STEP_OFF, apart - STEP_OFF, np.minimum(apart + STEP_ON, 0.0))
    e = np.where(fired == turn, apart, outside)
    near = np.abs(q) < PROFILE.reach_px
    return np.where(near, e, 0.0), -PROFILE.slope(q), dx / rho, dy / rho, near


def test_the_normal_equations_equal_their_twin() -> None:
    maps, sums = random_maps(3), np.zeros(5)
    tables = profile_tables([PROFILE])
    disc = (23.3, 20.6, RADIUS_PX, float(tables[1][0]))
    normal_equations_kernel(maps, disc, tables[0][0], sums)
    e, slope, ux, uy, near = residuals(maps, 23.3, 20.6)
    weight = 1.0 / (maps[1] + MODEL_VARIANCE) * np.where(maps[2] == TURN, 1.0, 0.4)
    weight = np.where(near & (e != 0.0), weight / (1.0 + (e / SOFT_RESIDUAL) ** 2), 0.0)
    jx, jy = slope * ux, slope * uy
    pairs = (jx, jx), (jx, jy), (jy, jy), (jx, e), (jy, e)
    expected = [(weight * a * b).sum() for a, b in pairs]
    np.testing.assert_allclose(sums, expected, rtol=0.02, atol=2.0)


def test_the_step_solves_for_the_place() -> None:
    rng = np.random.default_rng(8)
    jacobian, e = rng.normal(0.0, 1.0, (30, 2)), rng.normal(0.0, 1.0, 30)
    (xx, xy), (_, yy) = jacobian.T @ jacobian
    sums = np.array([xx, xy, yy, *(jacobian.T @ e)])
    away, prior = np.array([0.3, -0.2]), 0.04
    system = jacobian.T @ jacobian + np.eye(2) / prior
    *step, variance = solve_kernel(sums, tuple(away), prior)
    np.testing.assert_allclose(step, np.linalg.solve(system, jacobian.T @ e + away / prior))
    assert variance == pytest.approx(np.diag(np.linalg.inv(system)).mean())


def test_levels_are_corrected_by_their_gain_and_never_beyond_their_band() -> None:
    maps = random_maps(4)
    before, known = maps[0].copy(), maps[1].copy()
    tables = profile_tables([PROFILE])
    disc = (24.0, 20.0, RADIUS_PX, float(tables[1][0]))
    agreement = correct_levels_kernel(maps, disc, tables[0][0], 0.01)
    maps_before = (before, known, *maps[2:])
    e, slope, _, _, near = residuals(maps_before, 24.0, 20.0)
    gain = np.minimum(known / (known + MODEL_VARIANCE + slope**2 * 0.01), 0.3)
    gain /= 1.0 + (e / SOFT_RESIDUAL) ** 2
    np.testing.assert_allclose(maps[0], before - gain * e, atol=0.02)
    np.testing.assert_array_equal(maps[0][~near], before[~near])
    np.testing.assert_array_equal(maps[1][maps[2] != TURN], known[maps[2] != TURN])
    assert (maps[1] <= known).all()
    assert 0.5 < agreement < 1.0


def course(
    tracker: MarkerTracker, packet: EventPacket, cuts: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return times, us, and places, px, that a tracker finds in a stream of so many packets."""
    edges = np.linspace(0, packet.t_end_us, cuts + 1).astype(int).tolist()
    index = np.searchsorted(packet.t, edges).tolist()
    spans = zip(index, index[1:], edges, edges[1:], strict=False)
    frames = list(follow([packet.part(*span) for span in spans], tracker, 1_000.0))
    places_px = np.array([frame.detected_px for frame in frames])
    return np.array([frame.t_us for frame in frames]), places_px


def test_presses_of_a_sensor_with_rare_off_events_are_followed_however_they_are_cut() -> None:
    packet, preset = rare_off_events(), load_config("default").tracking
    bands, graded = (
        make_tracker(config, rare_off_calibration())
        for config in (preset, replace(preset, rare_off_method=""))
    )
    t_us, found_px = course(bands, packet)
    true_px = presses_px()[(t_us // PERIOD_US - 1).clip(0)]
    error_px = np.linalg.norm(found_px - true_px, axis=2)
    assert error_px.mean() < 0.25
    assert error_px.max() < 1.0
    other_px = np.linalg.norm(course(graded, packet)[1] - true_px, axis=2)
    assert error_px.mean() < 0.7 * other_px.mean()
    bands.reset()
    np.testing.assert_array_equal(course(bands, packet, cuts=37)[1], found_px)
