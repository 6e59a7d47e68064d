"""Disc fit and leak kernels against plain twins."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.markers.graded import disc_fit
from spikingtac.markers.graded.appearance import (
    FLAT_SHARE,
    LANES,
    LARGEST_SUM,
    PHASES,
    REACH_PX,
    FitWindow,
    fit_window,
)
from spikingtac.markers.graded.disc_fit import (
    MOST_GROWTH,
    SOFT_LEVEL,
    edge_bounds_kernel,
    fit_disc_kernel,
    fit_scratch,
    ring_kernel,
)
from spikingtac.markers.graded.map_leak import (
    GROUPS,
    OUTER_PX,
    RADIUS_PULL_PER_S,
    TOLERANCE,
    leak_ground_kernel,
    leak_kernel,
)
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX, GradedStateMap
from stand_ins.known import moving_markers
from stand_ins.rare_off import levels as levels_of

SIZE = (80, 60)
REFERENCE_PX = np.array([[18.0, 20.0], [55.0, 22.0], [30.0, 45.0]])
RADIUS_PX = np.array([7.0, 6.5, 5.0])
PROFILE = DiscProfile(6.0, 0.6)
WINDOW = fit_window(DiscProfile(np.full(3, 6.0), np.full(3, 0.6)), SIZE[0], 16.0)
ROUND_PX = np.column_stack([RADIUS_PX, np.zeros((3, 2))])


def fit_maps(level: np.ndarray, window: FitWindow) -> tuple[Any, Any]:
    """Return a map for fits, and their scratch."""
    flat = GradedStateMap(level).padded.ravel(), level.shape[1], level.shape[0]
    return flat, np.zeros((3, window.offset.shape[2]), np.float32)


def maps_of(state_map: GradedStateMap) -> tuple[np.ndarray, np.ndarray]:
    return state_map.padded.ravel(), state_map.pixels


def fitted(
    level: np.ndarray, start_px: np.ndarray, iterations: int = 8, gain: float = 1e-9
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the three discs are found, px, their agreements and their outlines, px."""
    maps, found, outline_px = fit_maps(level, WINDOW), [], ROUND_PX.copy()
    for m in range(3):
        settings = iterations, gain, RADIUS_PX[m]
        start = start_px[m, 0], start_px[m, 1]
        found.append(fit_disc_kernel(*maps, WINDOW, m, start, outline_px, settings))
    return np.array(found)[:, :2], np.array(found)[:, 2], outline_px


def levels(center_px: np.ndarray) -> np.ndarray:
    return levels_of(center_px, PROFILE, SIZE, RADIUS_PX).astype(np.float32)


def cauchy_fit(level: np.ndarray, start: np.ndarray, radius: float, reach: float) -> np.ndarray:
    """Minimise the same robust cost over all pixels near the edge, by scipy."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    near = np.hypot(x - start[0], y - start[1]) < radius + reach

    def residual(center: np.ndarray) -> np.ndarray:
        q = np.hypot(x - center[0], y - center[1]) - radius
        return (level - PROFILE.level(q))[near]

    return least_squares(residual, start, loss="cauchy", f_scale=SOFT_LEVEL).x


BORDER_PX = np.array([[2.0, 30.0], REFERENCE_PX[1], [40.0, 58.5]])  # No pixel outside is read.


@pytest.mark.parametrize("start_px", [REFERENCE_PX, BORDER_PX])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (-1.7, 1.2)])
def test_disc_fit_finds_exact_discs(start_px: np.ndarray, shift: tuple[float, float]) -> None:
    found_px, agreement, _ = fitted(levels(start_px), start_px - shift)
    np.testing.assert_allclose(found_px, start_px, atol=0.02)
    assert agreement[1] > 0.95


def test_disc_fit_equals_scipys_robust_minimum() -> None:
    rng = np.random.default_rng(5)
    noisy = levels(REFERENCE_PX + 0.3)
    noisy += rng.normal(0.0, 0.08, noisy.shape).astype(np.float32)
    spots = rng.random(noisy.shape) < 0.01
    noisy[spots] = rng.random(int(spots.sum()))
    found_px = fitted(noisy, REFERENCE_PX, iterations=20)[0]
    for found, start, radius in zip(found_px, REFERENCE_PX, RADIUS_PX, strict=True):
        expected = cauchy_fit(noisy, start, radius, 4.0)
        np.testing.assert_allclose(found, expected, atol=0.06)


@pytest.mark.parametrize("away_px", [4.0, 6.0])
def test_one_step_goes_no_farther_than_the_edge_is_linear(away_px: float) -> None:
    """The soft edge's uncut step from 6 px away is 3.6 px long."""
    soft = DiscProfile(6.0, 1.5)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = soft.level(np.hypot(x - 40.0, y - 30.0) - 7.0).astype(np.float32)
    window = fit_window(soft, SIZE[0], 16.0)
    start = 40.0 + 0.6 * away_px, 30.0 - 0.8 * away_px
    outline = np.array([[7.0, 0.0, 0.0]])
    maps = fit_maps(level, window)
    *found, _, step_px = fit_disc_kernel(*maps, window, 0, start, outline, (1, 0.0, 7.0))
    assert step_px == pytest.approx(2.0)
    np.testing.assert_allclose(np.subtract(found, start), [-1.2, 1.6], atol=0.1)


def test_normal_equations_equal_their_twin() -> None:
    rng, window, moved_px = np.random.default_rng(11), WINDOW, (0.03, -0.05)
    phase, first, count, whole = 6, 20, 300, 304  # whole vectors of pixels
    x, y, r, b, c = disc = 0.07, -0.12, 7.1, 0.2, -0.1
    half = float(window.edge[1, 1] - window.edge[1, 0]) / 2.0
    edge = np.empty((3, whole), np.float32)
    edge[0] = rng.random(whole)
    level, m = edge[0, :count].astype(float), np.uint64(1)
    ring = np.uint64(phase), np.uint64(first), np.int32(count), np.uint64(whole)
    read = tuple(np.float32(value) for value in (*disc, 1.0 / half))
    disc_fit._edge_kernel(window.polar, ring, read, window.coefficients, edge, m)
    moved = tuple(np.float32(way) for way in moved_px)
    asked = window.polar, ring, edge, moved, window.edge[1, 2]
    *sums, agreement = disc_fit.normal_equations_kernel(*asked)
    distance, ux, uy = window.polar[phase, :3, first : first + count].astype(float)
    rho, phi = distance - ux * x - uy * y, np.arctan2(uy, ux)
    z = np.clip((rho - r - b * np.cos(2 * phi) - c * np.sin(2 * phi)) / half, -1.0, 1.0)
    curve, slope = (
        np.polynomial.polynomial.polyval(z, row.astype(float)) for row in window.coefficients[1]
    )
    u = np.array([np.cos(phi), np.sin(phi)])
    slope *= np.abs(z) < 1.0
    e = level - curve - slope * (np.array(moved_px) @ u)
    ws = slope / (1.0 + e**2 / 0.64)
    gradients = [
        (ws * e * v).sum() for v in (*u, np.ones_like(z), np.cos(2 * phi), np.sin(2 * phi))
    ]
    curvature = [(ws * slope * v).sum() for v in (u[0] ** 2, u[0] * u[1], u[1] ** 2)]
    expected = [*curvature, *gradients, ws.sum() / slope.sum()]
    np.testing.assert_allclose([*np.concatenate(sums), agreement], expected, atol=0.01, rtol=1e-3)


@pytest.mark.parametrize("profile", [PROFILE, DiscProfile(6.0, 0.3), DiscProfile(12.0, 0.2)])
def test_the_window_shows_the_edge_where_it_is_steep(profile: DiscProfile) -> None:
    both = np.array([[2.5, 0.9], [profile.contrast, profile.edge_px]]).T
    window = fit_window(DiscProfile(*both), SIZE[0], 16.0)
    inner_px, outer_px, unit = window.edge[1].astype(float)
    q_px, z = np.linspace(inner_px, outer_px, 401), np.linspace(-1.0, 1.0, 401)
    level, slope = (np.polynomial.polynomial.polyval(z, row) for row in window.coefficients[1])
    steepest = -profile.slope(np.linspace(-4.0, 4.0, 4001)).min()
    np.testing.assert_allclose(level, profile.level(q_px), atol=0.002)
    np.testing.assert_allclose(slope, -profile.slope(q_px), atol=0.03 * steepest)
    for beyond in (inner_px - 0.05, outer_px + 0.05):
        assert abs(beyond) > REACH_PX or -profile.slope(beyond) < FLAT_SHARE * steepest
    most = unit * window.offset.shape[2] * max(1.0, steepest) ** 2
    assert np.log2(unit) % 1.0 == 0.0
    assert LARGEST_SUM / 3.0 < most < LARGEST_SUM * 1.1, "the sums of every pixel fit into 32 bits"


@pytest.mark.parametrize("outline", [(7.0, 0.0, 0.0), (5.2, 0.5, -0.4), (1.0, 0.0, 0.0)])
def test_a_ring_holds_every_pixel_of_the_edge(outline: tuple[float, float, float]) -> None:
    x, y = 40.4, 29.7
    inner_px, outer_px = (float(end) for end in WINDOW.edge[0, :2])
    parts = np.floor(PHASES * (np.array([x, y]) + 0.5))
    bulge = abs(outline[1]) + abs(outline[2])
    ends_px = outline[0] - bulge + inner_px, outline[0] + bulge + outer_px
    assert edge_bounds_kernel(WINDOW, 0, np.array([outline])) == pytest.approx(ends_px)
    phase = int(parts[0]) % PHASES + PHASES * (int(parts[1]) % PHASES)
    phase, first, count, whole = (int(n) for n in ring_kernel(WINDOW, phase, ends_px, 999))
    assert (whole % LANES, whole // LANES) == (0, -(-count // LANES))
    stride = SIZE[0] + 2 * PAD_PX
    row, column = np.divmod(WINDOW.offset[phase, 0] + PAD_PX * (stride + 1), stride)
    at_px = np.array([column - PAD_PX + 40.0, row - PAD_PX + 30.0])
    away = at_px - ((parts + 0.5) / PHASES - 0.5)[:, np.newaxis]
    seen, distance = np.hypot(*away), np.hypot(at_px[0] - x, at_px[1] - y)
    to_x, to_y = away / seen
    expected = [seen, to_x, to_y, to_x**2 - to_y**2, 2.0 * to_x * to_y]
    np.testing.assert_allclose(WINDOW.polar[phase], expected, atol=1e-5)
    np.testing.assert_array_equal(WINDOW.offset[phase, 1:], [row - PAD_PX, column - PAD_PX])
    needed = (distance >= ends_px[0]) & (distance <= ends_px[1])
    inside = np.zeros(needed.size, bool)
    inside[first : first + count] = True
    assert not (needed & ~inside).any()
    assert count < 1.4 * needed.sum() + 8


def test_outlines_follow_magnified_and_strained_discs_within_limits() -> None:
    true_px = np.array([[7.5, 0.6, -0.3], [6.0, -0.4, 0.5], [9.0, 0.0, 0.0]])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = np.zeros((SIZE[1], SIZE[0]))
    for (cx, cy), (r, b, c) in zip(REFERENCE_PX + 0.2, true_px, strict=True):
        phi = np.arctan2(y - cy, x - cx)
        edge = r + b * np.cos(2 * phi) + c * np.sin(2 * phi)
        level = np.maximum(level, PROFILE.level(np.hypot(x - cx, y - cy) - edge))
    maps, outline_px = fit_maps(level.astype(np.float32), WINDOW), ROUND_PX.copy()
    for m in range(3):
        start, settings = tuple(REFERENCE_PX[m].tolist()), (8, 0.95, RADIUS_PX[m])
        for _ in range(30):
            found = fit_disc_kernel(*maps, WINDOW, m, start, outline_px, settings)
        np.testing.assert_allclose(found[:2], REFERENCE_PX[m] + 0.2, atol=0.015 + 0.5 * (m == 2))
    np.testing.assert_allclose(outline_px[:2], true_px[:2], atol=0.05)
    assert outline_px[2, 0] == pytest.approx((1.0 + MOST_GROWTH) * RADIUS_PX[2])


def test_leak_equals_its_twin_and_spares_the_edge() -> None:
    rng = np.random.default_rng(8)
    start = np.clip(levels(REFERENCE_PX) + rng.normal(0.0, 0.2, (SIZE[1], SIZE[0])), 0.0, 1.0)
    state_map = GradedStateMap(start.astype(np.float32))  # all of it lies around marker 0
    reach, step, share, drawing = OUTER_PX, 0.4, 0.25, 0.1
    noise_hz_px, tolerance = 2.0, TOLERANCE * step
    own_s = -np.log1p(-drawing) / (RADIUS_PULL_PER_S * noise_hz_px**2)
    outline_px = ROUND_PX.copy()
    outline_px[1] = 6.2, 0.4, -0.3
    markers = moving_markers(REFERENCE_PX)
    markers["radius_px"] = RADIUS_PX
    states = markers, outline_px, np.ones(3), *WINDOW, fit_scratch(16.0)
    discs = np.full(3, PROFILE.steepest), np.full(3, step)
    for turn in range(3):
        law = turn, own_s / GROUPS, -np.log1p(-share) / own_s, noise_hz_px
        leak_kernel(*maps_of(state_map), *states, *discs, *law)
    expected, sure, (y, x) = start.copy(), np.ones(start.shape, bool), np.indices(start.shape)
    inner_px, outer_px = WINDOW.edge[0, :2]
    for (cx, cy), (r, b, c), radius in zip(REFERENCE_PX, outline_px, RADIUS_PX, strict=True):
        rho, phi = np.hypot(x - cx, y - cy), np.arctan2(y - cy, x - cx)
        q = rho - r - b * np.cos(2 * phi) - c * np.sin(2 * phi)
        steep = (q > inner_px) * (q < outer_px) * -PROFILE.slope(q) / PROFILE.steepest
        excess = start - np.where(q < inner_px, 1.0, PROFILE.level(np.minimum(q, outer_px)))
        gives = share * (1.0 - np.sqrt(steep)) * (excess - np.clip(excess, -tolerance, tolerance))
        gives += drawing * (r - radius) * steep * PROFILE.steepest
        expected -= (rho <= r + reach) * gives
        sure &= np.abs(rho - r - reach) > 0.6  # a ring ends at a whole quarter of a px
    sums = state_map.pixels["level"]
    np.testing.assert_allclose(sums[sure], np.clip(expected, 0.0, 1.0)[sure], atol=0.01)
    np.testing.assert_allclose(state_map.values, sums, atol=1e-6)
    assert np.abs(sums - start).max() > 0.02
    assert sure.mean() > 0.7


@pytest.mark.parametrize("first", [0, 2])
def test_the_ground_returns_to_its_level(first: int) -> None:
    start = np.random.default_rng(10).random((SIZE[1], SIZE[0])).astype(np.float32)
    state_map = GradedStateMap(start)
    center_px = np.array([[18.3, 20.6], [79.0, 2.0], [-30.0, 45.0]])  # one cut, one off the sensor
    reach_px = np.array([9.5, 8.0, 6.0])
    every, (step, share), around = 3, (0.14, 0.4), state_map.pixels["marker"]
    y, x = np.indices(start.shape)
    away_px = np.hypot(*(center_px - np.stack([x, y], axis=2)[:, :, np.newaxis]).T).T
    around[:] = np.where((away_px > reach_px).all(axis=2), 3, 0)  # 3 is around none
    leak_ground_kernel(state_map.padded.ravel(), state_map.pixels, 3, (first, every), (step, share))
    returns = (around == 3) & (y % every == first)
    expected = start - share * returns * np.maximum(start - step, 0.0)
    np.testing.assert_allclose(state_map.pixels["level"], expected, atol=1e-6)
    np.testing.assert_allclose(state_map.values, expected, atol=1e-6)
    assert (state_map.padded[:, :PAD_PX] == OUTSIDE_LEVEL).all()
