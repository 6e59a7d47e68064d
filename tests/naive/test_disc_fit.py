"""Disc fit, leak and centroid kernels against plain twins."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scipy.optimize import least_squares

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers import edge_equations
from spikingtac.markers.graded import disc_fit
from spikingtac.markers.graded.centroid.centroid_locator import (
    BLOCK_PX,
    CentroidLocator,
    CentroidLocatorConfig,
    round_window,
)
from spikingtac.markers.graded.centroid.cut_discs import SEEN_STEP_PX, cut_discs, uncut_kernel
from spikingtac.markers.graded.disc_fit import ROUNDING_PX, SOFT_LEVEL, round_outline
from spikingtac.markers.graded.disc_locator import DiscLocator, DiscLocatorConfig
from spikingtac.markers.graded.fit_window import (
    COEFFICIENT_DECIMALS,
    CURVE_POINTS,
    FLAT_SHARE,
    POLYNOMIAL_DEGREE,
    fit_window,
)
from spikingtac.markers.graded.map_leak import (
    ease_outlines_kernel,
    leak_to_discs_kernel,
    return_ground_kernel,
)
from spikingtac.markers.graded.profile_tables import profile_tables
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX, GradedStateMap

SIZE = (80, 60)
REFERENCE_PX = np.array([[18.0, 20.0], [55.0, 22.0], [30.0, 45.0]])
RADIUS_PX = np.array([7.0, 6.5, 5.0])
PROFILE = DiscProfile(6.0, 0.6)
TABLES = profile_tables([PROFILE] * 3)
CALIBRATION = Calibration(
    reference_px=REFERENCE_PX,
    radius_px=RADIUS_PX,
    grid=(1, 3),
    size=SIZE,
    contrast=6.0,
    edge_px=0.6,
)


def levels(center_px: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    out = np.zeros((SIZE[1], SIZE[0]))
    for (cx, cy), radius in zip(center_px, RADIUS_PX, strict=True):
        out = np.maximum(out, PROFILE.level(np.hypot(x - cx, y - cy) - radius))
    return out.astype(np.float32)


def cauchy_fit(level: np.ndarray, start: np.ndarray, radius: float, reach: float) -> np.ndarray:
    """Minimise the same robust cost over all pixels near the edge, by scipy."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    near = np.hypot(x - start[0], y - start[1]) < radius + reach

    def residual(center: np.ndarray) -> np.ndarray:
        q = np.hypot(x - center[0], y - center[1]) - radius
        return (level - PROFILE.level(q))[near]

    return least_squares(residual, start, loss="cauchy", f_scale=SOFT_LEVEL).x


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (-1.7, 1.2)])
def test_disc_fit_finds_exact_discs(shift: tuple[float, float]) -> None:
    true_px = REFERENCE_PX + shift
    locator = DiscLocator(DiscLocatorConfig(iterations=8, grid_weight=0.0), CALIBRATION)
    found_px, agreement = locator.locate(GradedStateMap(levels(true_px)), REFERENCE_PX, None, 0.0)
    np.testing.assert_allclose(found_px, true_px, atol=0.01)
    assert agreement.min() > 0.95


def test_disc_fit_equals_scipys_robust_minimum() -> None:
    rng = np.random.default_rng(5)
    noisy = levels(REFERENCE_PX + 0.3)
    noisy += rng.normal(0.0, 0.08, noisy.shape).astype(np.float32)
    spots = rng.random(noisy.shape) < 0.01
    noisy[spots] = rng.random(int(spots.sum()))
    locator = DiscLocator(
        DiscLocatorConfig(iterations=20, grid_weight=0.0, reach_px=4.0), CALIBRATION
    )
    found_px, _ = locator.locate(GradedStateMap(noisy), REFERENCE_PX, None, 0.0)
    for found, start, radius in zip(found_px, REFERENCE_PX, RADIUS_PX, strict=True):
        expected = cauchy_fit(noisy, start, radius, 4.0)
        np.testing.assert_allclose(found, expected, atol=0.06)


@pytest.mark.parametrize("moved_px", [(0.0, 0.0), (0.03, -0.05)])
def test_normal_equations_equal_their_twin(moved_px: tuple[float, float]) -> None:
    rng = np.random.default_rng(11)
    window = fit_window([PROFILE], SIZE[0], 3.5)
    first, count = 20, 300
    x, y, r, b, c = disc = 0.2, -0.3, 7.1, 0.2, -0.1
    half = float(window.outer_px[0] - window.inner_px[0]) / 2.0
    edge = np.empty((5, window.offset.size), np.float32)
    level = edge[0, :count] = rng.random(count).astype(np.float32)
    disc_fit._edge_kernel(
        window.place_px,
        (np.uint64(first), np.uint64(count)),
        tuple(np.float32(value) for value in (*disc, 1.0 / half)),
        window.coefficients[0],
        edge,
    )
    moved = np.float32(moved_px[0]), np.float32(moved_px[1])
    read = edge, np.uint64(count), moved, np.float32(1.5625), window.unit[0]
    second, center = edge_equations.center_equations_kernel(*read)
    outline, rr, agreement = edge_equations.outline_equations_kernel(*read)
    got = [*second, *center, *outline, rr, agreement]
    dx, dy = window.place_px[:, first : first + count].astype(float)
    rho, phi = np.hypot(dx - x, dy - y), np.arctan2(dy - y, dx - x)
    z = np.clip((rho - r - b * np.cos(2 * phi) - c * np.sin(2 * phi)) / half, -1.0, 1.0)
    curve, slope = (
        np.polynomial.polynomial.polyval(z, row.astype(float)) for row in window.coefficients[0]
    )
    u = np.array([np.cos(phi), np.sin(phi)])
    e = level - curve - slope * (np.array(moved_px) @ u)
    ws = slope / (1.0 + e**2 / 0.64)
    gradients = [
        (ws * e * v).sum() for v in (*u, np.ones_like(z), np.cos(2 * phi), np.sin(2 * phi))
    ]
    curvature = [
        (ws * slope * v).sum() for v in (u[0] ** 2, u[0] * u[1], u[1] ** 2, np.ones_like(z))
    ]
    expected = [*curvature[:3], *gradients, curvature[3], ws.sum() / slope.sum()]
    np.testing.assert_allclose(got, expected, atol=0.01, rtol=1e-3)


@pytest.mark.parametrize("profile", [PROFILE, DiscProfile(6.0, 0.3), DiscProfile(12.0, 0.2)])
def test_a_unit_lets_the_sums_of_every_pixel_fit_into_32_bits(profile: DiscProfile) -> None:
    window = fit_window([profile], SIZE[0], 3.5)
    steepest = max(1.0, -profile.slope(np.linspace(-4.0, 4.0, 4001)).min())
    most = window.unit[0] * window.offset.size * steepest**2
    assert np.log2(window.unit[0]) % 1.0 == 0.0
    assert edge_equations.LARGEST_SUM / 3.0 < most < edge_equations.LARGEST_SUM * 1.1


@pytest.mark.parametrize("profile", [PROFILE, DiscProfile(6.0, 0.3), DiscProfile(12.0, 0.2)])
def test_the_window_shows_the_edge_where_it_is_steep(profile: DiscProfile) -> None:
    window = fit_window([profile], SIZE[0], 3.5)
    inner_px, outer_px = float(window.inner_px[0]), float(window.outer_px[0])
    half = (outer_px - inner_px) / 2.0
    q_px = np.linspace(inner_px, outer_px, 401)
    z = (q_px - inner_px) / half - 1.0
    level, slope = (np.polynomial.polynomial.polyval(z, row) for row in window.coefficients[0])
    steepest = -profile.slope(np.linspace(-4.0, 4.0, 4001)).min()
    np.testing.assert_allclose(level, profile.level(q_px), atol=0.001)
    np.testing.assert_allclose(slope, -profile.slope(q_px), atol=0.02 * steepest)
    for beyond in (inner_px - 0.05, outer_px + 0.05):
        assert abs(beyond) > 3.5 or -profile.slope(beyond) < FLAT_SHARE * steepest


@pytest.mark.parametrize("outline", [(7.0, 0.0, 0.0), (5.2, 0.5, -0.4), (1.0, 0.0, 0.0)])
def test_a_ring_holds_every_pixel_of_the_edge(outline: tuple[float, float, float]) -> None:
    window = fit_window([PROFILE], SIZE[0], 3.5)
    state = np.array([10.4, 9.7, *outline])
    inner_px, outer_px = float(window.inner_px[0]), float(window.outer_px[0])
    first, count = (int(n) for n in disc_fit._ring_kernel(window.within, state, inner_px, outer_px))
    distance = np.hypot(*window.place_px.astype(float))
    bulge = abs(outline[1]) + abs(outline[2]) + ROUNDING_PX
    needed = distance >= outline[0] - bulge + inner_px
    needed &= distance <= outline[0] + bulge + outer_px
    inside = np.zeros(needed.size, bool)
    inside[first : first + count] = True
    assert not (needed & ~inside).any()
    assert count < 1.4 * needed.sum() + 8


def test_neighbours_pull_only_as_much_as_asked() -> None:
    state_map = GradedStateMap(levels(REFERENCE_PX))
    expected_px = REFERENCE_PX + 1.0
    free, _ = DiscLocator(DiscLocatorConfig(grid_weight=0.0), CALIBRATION).locate(
        state_map, REFERENCE_PX, expected_px, 0.0
    )
    pulled, _ = DiscLocator(DiscLocatorConfig(grid_weight=0.05), CALIBRATION).locate(
        state_map, REFERENCE_PX, expected_px, 0.0
    )
    assert 0.01 < (pulled - free).min() < (pulled - free).max() < 0.1


def test_a_marker_at_the_border_reads_no_pixel_outside() -> None:
    true_px = np.array([[2.0, 30.0]])
    calibration = Calibration(
        reference_px=true_px,
        radius_px=np.array([7.0]),
        grid=(1, 1),
        size=SIZE,
        contrast=6.0,
        edge_px=0.6,
    )
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = PROFILE.level(np.hypot(x - 2.0, y - 30.0) - 7.0).astype(np.float32)
    locator = DiscLocator(DiscLocatorConfig(iterations=8), calibration)
    found_px, _ = locator.locate(GradedStateMap(level), true_px + 0.8, None, 0.0)
    np.testing.assert_allclose(found_px, true_px, atol=0.02)


def test_outlines_follow_magnified_and_strained_discs() -> None:
    outline_px = np.array([[7.5, 0.6, -0.3], [6.0, -0.4, 0.5], [5.2, 0.0, 0.3]])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = np.zeros((SIZE[1], SIZE[0]))
    for (cx, cy), (r, b, c) in zip(REFERENCE_PX + 0.2, outline_px, strict=True):
        phi = np.arctan2(y - cy, x - cx)
        edge = r + b * np.cos(2 * phi) + c * np.sin(2 * phi)
        level = np.maximum(level, PROFILE.level(np.hypot(x - cx, y - cy) - edge))
    locator = DiscLocator(DiscLocatorConfig(grid_weight=0.0), CALIBRATION)
    state_map = GradedStateMap(level.astype(np.float32))
    for _ in range(30):
        found_px, agreement = locator.locate(state_map, REFERENCE_PX, None, 0.02)
    np.testing.assert_allclose(locator.outline_px, outline_px, atol=0.05)
    np.testing.assert_allclose(found_px, REFERENCE_PX + 0.2, atol=0.01)
    assert agreement.min() > 0.98
    locator.reset()
    np.testing.assert_array_equal(locator.outline_px, round_outline(RADIUS_PX))


def test_leak_equals_its_twin_and_spares_the_edge() -> None:
    rng = np.random.default_rng(8)
    start = np.clip(levels(REFERENCE_PX) + rng.normal(0.0, 0.2, (SIZE[1], SIZE[0])), 0.0, 1.0)
    state_map = GradedStateMap(start.astype(np.float32))
    reach, tolerance, share = 3.0, 0.14, 0.25
    outline_px = round_outline(RADIUS_PX)
    outline_px[1] = 6.2, 0.4, -0.3
    leak_to_discs_kernel(
        state_map.padded,
        state_map.memory,
        REFERENCE_PX,
        outline_px,
        TABLES.of(slice(None)),
        reach,
        np.full(3, tolerance),
        share,
    )
    expected = start.copy()
    steepest = PROFILE.slope(np.linspace(-4, 4, 4001)).min()
    for y in range(SIZE[1]):
        for x in range(SIZE[0]):
            for (cx, cy), (r, b, c) in zip(REFERENCE_PX, outline_px, strict=True):
                rho, phi = np.hypot(x - cx, y - cy), np.arctan2(y - cy, x - cx)
                q = rho - r - b * np.cos(2 * phi) - c * np.sin(2 * phi)
                excess = start[y, x] - PROFILE.level(q)
                if rho <= r + reach and abs(excess) > tolerance:
                    weight = 1.0 - np.sqrt(PROFILE.slope(q) / steepest)
                    expected[y, x] -= share * weight * (excess - np.sign(excess) * tolerance)
    expected = np.clip(expected, 0.0, 1.0)
    np.testing.assert_allclose(state_map.memory, expected, atol=0.01)
    np.testing.assert_array_equal(state_map.values, state_map.memory)
    assert np.abs(state_map.memory - start).max() > 0.02


@pytest.mark.parametrize("first", [0, 2])
def test_the_ground_returns_to_its_level(first: int) -> None:
    start = np.random.default_rng(10).random((SIZE[1], SIZE[0])).astype(np.float32)
    state_map = GradedStateMap(start)
    center_px = np.array([[18.3, 20.6], [79.0, 2.0], [-30.0, 45.0]])  # one cut, one off the sensor
    reach_px = np.array([9.5, 8.0, 6.0])
    every, (step, below, above) = 3, (0.14, 0.1, 0.4)
    law = step, below, above
    return_ground_kernel(
        state_map.padded, state_map.memory, (first, every), (center_px, reach_px), law
    )
    expected = start.astype(float)
    for y in range(first, SIZE[1], every):
        for x in range(SIZE[0]):
            if (np.hypot(*(center_px - (x, y)).T) > reach_px).all():
                over = max(start[y, x] - step, 0.0)
                expected[y, x] -= below * min(start[y, x], step) + above * over
    np.testing.assert_allclose(state_map.memory, expected, atol=1e-6)
    np.testing.assert_allclose(state_map.values, expected, atol=1e-6)
    assert (state_map.padded[:, :PAD_PX] == OUTSIDE_LEVEL).all()


def test_resting_discs_ease_towards_their_calibrated_outlines() -> None:
    rng = np.random.default_rng(9)
    start = np.clip(levels(REFERENCE_PX) + rng.normal(0.0, 0.2, (SIZE[1], SIZE[0])), 0.0, 1.0)
    state_map = GradedStateMap(start.astype(np.float32))
    outline_px = round_outline(RADIUS_PX)
    outline_px[0], outline_px[1] = (7.4, 0.2, -0.1), (6.2, 0.4, -0.3)
    velocity_px_s = np.array([[2.0, 1.0], [-3.0, 2.0], [0.0, 0.0]])  # rests, moves, is as it was
    share = 0.2
    ease_outlines_kernel(
        state_map.padded,
        state_map.memory,
        (REFERENCE_PX, velocity_px_s, outline_px),
        RADIUS_PX,
        TABLES.of(slice(None)),
        (share, 3.0),
    )
    (cx, cy), (r, b, c) = REFERENCE_PX[0], outline_px[0]
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    rho, phi = np.hypot(x - cx, y - cy), np.arctan2(y - cy, x - cx)
    bulge = b * np.cos(2 * phi) + c * np.sin(2 * phi)
    moved = share * (r - RADIUS_PX[0] + bulge) * PROFILE.slope(rho - r - bulge)
    moved[np.abs(rho - r - bulge) > PROFILE.reach_px] = 0.0
    expected = np.clip(start + moved, 0.0, 1.0)
    np.testing.assert_allclose(state_map.memory, expected, atol=0.002)
    np.testing.assert_allclose(state_map.values, state_map.memory, atol=1e-6)
    assert np.abs(moved).max() > 0.02


def test_centroids_equal_their_twin() -> None:
    rng = np.random.default_rng(4)
    level = np.clip(levels(REFERENCE_PX + 0.4) + rng.normal(0.0, 0.1, (SIZE[1], SIZE[0])), 0, 1)
    config = CentroidLocatorConfig()
    locator = CentroidLocator(config, CALIBRATION)
    found_px, _ = locator.locate(GradedStateMap(level.astype(np.float32)), REFERENCE_PX, None, 0.0)
    reach = RADIUS_PX.max() + config.reach_px
    for found, center in zip(found_px, REFERENCE_PX, strict=True):
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        weight = np.maximum(level - config.floor, 0.0)
        weight[np.hypot(x - center[0], y - center[1]) > reach] = 0.0
        expected = [(weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum()]
        np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize("radius_px", [0.4, 3.0, 9.5, 15.0, 15.5, 22.9])
def test_window_holds_the_pixels_within_the_radius(radius_px: float) -> None:
    weight = round_window(radius_px)
    middle = weight.shape[1] // 2
    expected = {(x, y) for x in range(-24, 25) for y in range(24) if np.hypot(x, y) <= radius_px}
    assert {(x - middle, y) for y, x in np.argwhere(weight).tolist()} == expected
    assert weight.shape[1] % BLOCK_PX == 0
    np.testing.assert_array_equal(np.unique(weight[0][weight[0] > 0]), [0.5])


@pytest.mark.parametrize("at_px", [(0.0, 0.0), (79.0, 59.0), (79.0, 0.0)])
def test_large_discs_are_found_in_corners(at_px: tuple[float, float]) -> None:
    reference_px = np.array([at_px])
    calibration = Calibration(
        reference_px=reference_px, radius_px=np.array([19.5]), grid=(1, 1), size=SIZE
    )
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    level = (np.hypot(x - at_px[0], y - at_px[1]) <= 19.5).astype(np.float32)
    locator = CentroidLocator(CentroidLocatorConfig(), calibration)
    found_px, _ = locator.locate(GradedStateMap(level), reference_px, None, 0.0)
    centroid_px = x[level > 0].mean(), y[level > 0].mean()
    assert np.linalg.norm(centroid_px - reference_px[0]) > 10.0
    np.testing.assert_allclose(found_px[0], at_px, atol=1.0)


def test_uncut_centres_are_those_of_the_tables() -> None:
    cut = cut_discs(RADIUS_PX, [PROFILE] * 3, 10.0, 0.25)
    last_px = 59.0
    for marker, place_px in product(range(3), np.linspace(-1.0, 60.0, 245)):
        center_px, whole = cut.center_px[marker], cut.whole[marker]
        depth_px = min(place_px, last_px - place_px)
        seen_px = SEEN_STEP_PX * np.arange(len(center_px))
        expected_px, expected_whole = depth_px, 1.0
        if depth_px < seen_px[-1]:
            expected_px = np.interp(depth_px, seen_px, center_px)
            expected_whole = np.interp(depth_px, seen_px, whole)
        if place_px > 0.5 * last_px:
            expected_px = last_px - expected_px
        found = uncut_kernel(place_px, last_px, center_px, whole)
        np.testing.assert_allclose(found, (expected_px, expected_whole), atol=1e-9)


def test_profiles_of_many_discs_are_fitted_as_each_alone() -> None:
    profiles = [DiscProfile(contrast, edge_px) for contrast, edge_px in ((2.5, 0.5), (6.0, 0.9))]
    together = fit_window(profiles, SIZE[0], 3.5)
    unit = np.linspace(-1.0, 1.0, CURVE_POINTS)
    for marker, profile in enumerate(profiles):
        inner_px, outer_px = together.inner_px[marker], together.outer_px[marker]
        level = profile.level(inner_px + (outer_px - inner_px) * (unit + 1.0) / 2.0)
        series = chebyshev.chebfit(unit, level, POLYNOMIAL_DEGREE)
        alone = np.round(chebyshev.cheb2poly(series), COEFFICIENT_DECIMALS)
        np.testing.assert_allclose(together.coefficients[marker, 0], alone, rtol=1e-6)
