"""The band map and the band fit against plain twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.config import load_config
from spikingtac.events.windows import windows
from spikingtac.markers.graded import band_fit
from spikingtac.markers.graded.appearance import appearance_of, profile_tables
from spikingtac.markers.graded.band_fit import MODEL_VARIANCE, SOFT_RESIDUAL
from spikingtac.markers.graded.band_locator import (
    GROUPS,
    BandLocator,
    recover_levels_kernel,
    recovering_px,
)
from spikingtac.markers.graded.motion import predict_radius_kernel
from spikingtac.markers.registry import make_tracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.pipeline.follow import follow
from spikingtac.state_map.bands import END_SHARE, THRESHOLD_MISMATCH, BandStateMap
from spikingtac.state_map.graded import PAD_PX, GradedStateMap
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


def random_packet(seed: int, count: int) -> EventPacket:
    rng = np.random.default_rng(seed)
    columns = (rng.integers(0, side, count).astype(np.uint16) for side in (9, 7))
    return EventPacket(*columns, rng.random(count) < 0.5, np.zeros(count, np.int64), 0, 1, (9, 7))


@pytest.mark.parametrize("dark", [False, True])
def test_the_map_equals_its_twin_however_it_is_cut(dark: bool) -> None:
    rng = np.random.default_rng(1)
    start, on, off = (rng.uniform(0.05, 0.4, (7, 9)).astype(np.float32) for _ in range(3))
    state_map = BandStateMap(start, on, off, dark_markers=dark)
    packet = random_packet(2, 600)
    memory = start + 0.5 * (off.astype(float) - on)
    variance, fired = (on + off.astype(float)) ** 2 / 12.0, np.zeros((7, 9))
    for x, y, p in zip(packet.x, packet.y, packet.p, strict=True):
        step = on[y, x] if p != dark else -off[y, x]
        low, high = END_SHARE * off[y, x], 1.0 - END_SHARE * on[y, x]
        memory[y, x] = min(max(memory[y, x] + step, low), high)
        variance[y, x] += (THRESHOLD_MISMATCH * step) ** 2
        fired[y, x] = state_map.turn
    for first, last in ((0, 1), (1, 1), (1, 333), (333, 600)):
        state_map.absorb(packet.part(first, last, 0, 1))
    np.testing.assert_allclose(state_map.memory, memory, atol=1e-5)
    np.testing.assert_allclose(state_map.variance, variance, rtol=1e-4)
    np.testing.assert_array_equal(state_map.fired, fired)
    state_map.reset()
    np.testing.assert_array_equal(state_map.values, start)
    assert not state_map.fired.any()


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
    maps, sums = random_maps(3), np.zeros(9)
    tables = profile_tables([PROFILE])
    disc = (23.3, 20.6, RADIUS_PX, float(tables[1][0]))
    band_fit._normal_equations_kernel(maps, disc, tables[0][0], sums)
    e, slope, ux, uy, near = residuals(maps, 23.3, 20.6)
    weight = 1.0 / (maps[1] + MODEL_VARIANCE) * np.where(maps[2] == TURN, 1.0, 0.4)
    weight = np.where(near & (e != 0.0), weight / (1.0 + (e / SOFT_RESIDUAL) ** 2), 0.0)
    jx, jy = slope * ux, slope * uy
    pairs = (jx, jx), (jx, jy), (jy, jy), (jx, slope), (jy, slope), (slope, slope)
    pairs += (jx, e), (jy, e), (slope, e)
    expected = [(weight * a * b).sum() for a, b in pairs]
    np.testing.assert_allclose(sums, expected, rtol=0.02, atol=2.0)


def test_the_step_solves_for_place_and_radius_together() -> None:
    rng = np.random.default_rng(8)
    jacobian, e = rng.normal(0.0, 1.0, (30, 3)), rng.normal(0.0, 1.0, 30)
    (xx, xy, xr), (_, yy, yr), (_, _, rr) = jacobian.T @ jacobian
    sums = np.array([xx, xy, yy, xr, yr, rr, *(jacobian.T @ e)])
    away, place, size = np.array([0.3, -0.2, 0.1]), 0.04, 0.09
    prior = np.diag([1.0 / place, 1.0 / place, 1.0 / size])
    system = jacobian.T @ jacobian + prior
    *step, variance = band_fit._solve_kernel(sums, tuple(away), (place, size))
    np.testing.assert_allclose(step, np.linalg.solve(system, jacobian.T @ e + prior @ away))
    assert variance == pytest.approx(np.diag(np.linalg.inv(system))[:2].mean())


@pytest.mark.parametrize(("recovery_s", "ahead_px"), [(0.2, 0.25), (None, 0.5)])
def test_a_disc_that_grew_is_not_taken_for_one_that_moved(
    recovery_s: float | None, ahead_px: float
) -> None:
    """Only one half of the edge fires: it went outwards, and the other half says nothing."""
    calibration = replace(rare_off_calibration(), recovery_s=recovery_s)
    locator = BandLocator(calibration)
    state_map = locator.map
    rest_px, radius_px = calibration.reference_px, calibration.radius_px[0]
    row, column = np.mgrid[: calibration.size[1], : calibration.size[0]]
    away_px = np.hypot(column - rest_px[0, 0], row - rest_px[0, 1])
    profile = appearance_of(calibration).profiles[0]
    front = (column > rest_px[0, 0]) & (np.abs(away_px - radius_px) < profile.reach_px)
    for k, grown_px in enumerate(np.linspace(0.05, 1.0, 20)):
        grown = profile.level(away_px - radius_px - grown_px)
        state_map.memory[front], state_map.fired[front] = grown[front], state_map.turn
        locator.locate(1_000 * k, np.zeros(len(rest_px), np.bool_))
    moved_px = locator.motion[0, :2] - rest_px[0]
    assert moved_px[0] < ahead_px if recovery_s else moved_px[0] > ahead_px
    assert abs(moved_px[1]) < 0.05


def test_levels_are_corrected_by_their_gain_and_never_beyond_their_band() -> None:
    maps = random_maps(4)
    before, known = maps[0].copy(), maps[1].copy()
    tables = profile_tables([PROFILE])
    disc = (24.0, 20.0, RADIUS_PX, float(tables[1][0]))
    agreement = band_fit._correct_levels_kernel(maps, disc, tables[0][0], 0.01)
    maps_before = (before, known, *maps[2:])
    e, slope, _, _, near = residuals(maps_before, 24.0, 20.0)
    gain = np.minimum(known / (known + MODEL_VARIANCE + slope**2 * 0.01), 0.3)
    gain /= 1.0 + (e / SOFT_RESIDUAL) ** 2
    np.testing.assert_allclose(maps[0], before - gain * e, atol=0.02)
    np.testing.assert_array_equal(maps[0][~near], before[~near])
    np.testing.assert_array_equal(maps[1][maps[2] != TURN], known[maps[2] != TURN])
    assert (maps[1] <= known).all()
    assert 0.5 < agreement < 1.0


def test_levels_above_their_disc_recover_and_others_are_left_alone() -> None:
    memory, _, _, _, _, padded = random_maps(5)
    before, expected = memory.copy(), padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX].copy()
    tables = profile_tables([PROFILE])
    discs = np.array([RADIUS_PX]), *tables
    place_px = np.array([[24.4, 20.2]])
    within_px = recovering_px(place_px, discs[0], discs[2])
    recover_levels_kernel(padded, memory, place_px, discs, within_px, np.array([0.4]))
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    away_px = np.hypot(column - 24.4, row - 20.2)
    excess = (before - PROFILE.level(away_px - RADIUS_PX)).clip(0.0)
    lost = np.where(away_px < within_px[0], 0.4 * excess, 0.0)
    np.testing.assert_allclose(memory, before - lost, atol=0.01)
    np.testing.assert_allclose(padded[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX], expected - lost, atol=0.01)
    assert lost[away_px > RADIUS_PX + discs[2][0] + 1.0].max() > 0.05, "former places recover"


def test_markers_recover_in_turn_and_as_fast_as_all_at_once() -> None:
    locator = BandLocator(replace(rare_off_calibration(), recovery_s=0.2))
    beside = np.rint(REST_PX + np.array([RADIUS_PX + 6.0, 0.0])).astype(int)
    locator.map.memory[beside[:, 1], beside[:, 0]] = 0.9
    before = locator.map.memory[beside[:, 1], beside[:, 0]].copy()
    for t_us in range(0, 1_000 * 12 * GROUPS + 1, 1_000):
        locator.locate(t_us, np.zeros(len(REST_PX), np.bool_))
    left = locator.map.memory[beside[:, 1], beside[:, 0]] / before
    np.testing.assert_allclose(left, np.exp(-0.001 * 12 * GROUPS / 0.2), rtol=0.05)


def test_levels_recover_no_nearer_to_the_next_disc_than_halfway() -> None:
    rest_px, radius_px = np.array([[0.0, 0.0], [24.0, 0.0]]), np.full(2, 6.0)
    np.testing.assert_array_equal(recovering_px(rest_px, radius_px, np.full(2, 4.0)), 12.0)
    np.testing.assert_array_equal(recovering_px(rest_px, radius_px, np.full(2, 8.0)), 14.0)
    np.testing.assert_array_equal(recovering_px(4.0 * rest_px, radius_px, np.full(2, 4.0)), 18.0)


def test_a_radius_returns_to_rest_and_its_variance_to_the_growth() -> None:
    radius = np.array([6.6, 0.01])
    predict_radius_kernel(radius, 0.3, 6.0, 0.2)
    kept = np.exp(-1.0)
    np.testing.assert_allclose(radius, [6.0 + 0.6 * kept, 1.44 + kept**2 * (0.01 - 1.44)])
    predict_radius_kernel(radius, 30.0, 6.0, 0.2)
    np.testing.assert_allclose(radius, [6.0, 1.44])
    predict_radius_kernel(radius, 30.0, 6.0, 0.0)
    assert 0.0 < radius[1] < 1e-9, "a radius that is known has a variance to divide by"


@pytest.fixture(scope="module")
def packet() -> EventPacket:
    return rare_off_events()


def errors_px(packet: EventPacket, preset: TrackingConfig, cuts: int = 1) -> np.ndarray:
    edges = np.linspace(0, packet.t_end_us, cuts + 1).astype(np.int64)
    index = np.searchsorted(packet.t, edges)
    parts = [
        packet.part(int(index[k]), int(index[k + 1]), int(edges[k]), int(edges[k + 1]))
        for k in range(cuts)
    ]
    frames = list(follow(parts, make_tracker(preset, rare_off_calibration()), 1_000.0))
    at = np.array([frame.t_us for frame in frames]) // PERIOD_US - 1
    true_px = presses_px()[at.clip(0)]
    return np.linalg.norm([frame.detected_px for frame in frames] - true_px, axis=2)


def test_presses_of_a_sensor_with_rare_off_events_are_followed(packet: EventPacket) -> None:
    preset = load_config("default").tracking
    bands, graded = (
        errors_px(packet, preset),
        errors_px(packet, replace(preset, rare_off_method="")),
    )
    assert bands.mean() < 0.25
    assert bands.max() < 1.0
    assert bands.mean() < 0.7 * graded.mean()


def test_any_cutting_gives_the_same_tracks(packet: EventPacket) -> None:
    bands = TrackingConfig(method="bands")
    np.testing.assert_array_equal(errors_px(packet, bands), errors_px(packet, bands, cuts=37))


def test_a_reset_forgets_everything_but_the_calibration(packet: EventPacket) -> None:
    tracker = make_tracker(TrackingConfig(method="bands"), rare_off_calibration())

    def course() -> np.ndarray:
        placed = []
        for window in windows([packet], 5_000):
            tracker.absorb(window)
            placed.append(tracker.estimate(window.t_end_us).detected_px)
        return np.array(placed)

    first = course()
    tracker.reset()
    np.testing.assert_array_equal(course(), first)
