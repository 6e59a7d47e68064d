"""The baselines' kernels against plain Python, on random and on edge arrays."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import ndimage

from spikingtac.types import EventPacket
from spikingtac_paper.baselines.ekalibr import Arc, find_arcs, pair_arcs
from spikingtac_paper.baselines.ekalibr_kernels import (
    NEVER,
    moving_circle_kernel,
    normal_flow_kernel,
)
from spikingtac_paper.baselines.evetac import (
    SliceBuffer,
    attraction_kernel,
    neighbours,
    regularizer_kernel,
)
from spikingtac_paper.baselines.neutac import TimeSurface


def plain_attraction(events, center, inner, outer, turn):
    pull, support = np.zeros_like(center), np.zeros(len(center), np.int64)
    for x, y in events:
        for m, (cx, cy) in enumerate(center):
            d = np.array([math.trunc(x - cx), math.trunc(y - cy)], float)
            rho = max(math.hypot(*d), 1.0)
            if inner < rho <= outer:
                pull[m] += 2.0 * (d - turn * d / rho)
                support[m] += np.count_nonzero(d)
    return pull, support


@pytest.mark.parametrize("count", [0, 1, 400])
def test_attraction(count: int) -> None:
    rng = np.random.default_rng(count)
    events = rng.integers(0, 60, (count, 2)).astype(np.uint16)
    center = rng.uniform(0, 60, (5, 2))
    pull, support = np.empty((5, 2)), np.empty(5, np.int64)
    columns = np.ascontiguousarray(events[:, 0]), np.ascontiguousarray(events[:, 1])
    attraction_kernel(*columns, center, 3.0, 14.0, 17.5, pull, support)
    expected = plain_attraction(events.astype(float), center, 3.0, 14.0, 17.5)
    np.testing.assert_allclose(pull, expected[0], atol=1e-9)
    np.testing.assert_array_equal(support, expected[1])


def test_regularizer() -> None:
    rng = np.random.default_rng(2)
    rest = np.array([[37.0 * i, 37.0 * j] for i in range(3) for j in range(3)])
    index, distance = neighbours(rest, 60.0)
    center = rest + rng.normal(0.0, 2.0, rest.shape)
    regularizer = np.empty((9, 2))
    regularizer_kernel(center, index, distance, regularizer)
    for i in range(9):
        near = index[i][index[i] >= 0]
        total = np.zeros(2)
        for j, d in zip(near, distance[i], strict=False):
            offset = center[j] - center[i]
            total += 4.0 * offset * (offset @ offset - d * d)
        np.testing.assert_allclose(regularizer[i], 8.0 / len(near) * total, rtol=1e-9)
    regularizer_kernel(rest, index, distance, regularizer)
    np.testing.assert_allclose(regularizer, 0.0, atol=1e-6)


@pytest.mark.parametrize("velocity", [(0.002, 0.0), (0.0, -0.001), (0.001, 0.001)])
def test_normal_flow_of_a_straight_edge(velocity: tuple[float, float]) -> None:
    """An edge that passes at v fires at t = n . x / |v| and its normal flow is v."""
    v = np.array(velocity)
    y, x = np.mgrid[:12, :12]
    times = ((x * v[0] + y * v[1]) / (v @ v)).round().astype(np.int64)
    flow = np.empty((2, 12, 12))
    normal_flow_kernel(times, int(times.min()), 2, 2_000.0, 0.6, flow)
    expected = np.broadcast_to(v[:, None, None], (2, 10, 10))
    np.testing.assert_allclose(flow[:, 1:-1, 1:-1], expected, rtol=0.01, atol=1e-5)
    assert not flow[:, 0].any()


def test_normal_flow_needs_enough_neighbours_and_leaves_outliers_out() -> None:
    times = np.full((5, 5), NEVER)
    times[2, 2] = times[2, 3] = 1_000
    flow = np.empty((2, 5, 5))
    normal_flow_kernel(times, 0, 2, 2_000.0, 0.6, flow)
    assert not flow.any()
    x = np.tile(np.arange(5), (5, 1))
    ramp = (1_000 * x + 20_000).astype(np.int64)
    ramp[1, 1] += 9_000
    normal_flow_kernel(ramp, 0, 2, 3_500.0, 0.6, flow)
    assert flow[:, 2, 2] == pytest.approx([0.001, 0.0], abs=1e-4)


def test_moving_circle_is_recovered() -> None:
    rng = np.random.default_rng(4)
    s = rng.uniform(-1.0, 0.0, 500)
    angle = rng.choice([0.0, np.pi], 500) + rng.uniform(-1.2, 1.2, 500)
    truth = np.array([40.0, 50.0, 6.0, -2.0, 7.0, 0.3])
    radius = truth[4] + truth[5] * s
    points = np.column_stack(
        [
            truth[0] + truth[2] * s + radius * np.cos(angle),
            truth[1] + truth[3] * s + radius * np.sin(angle),
            s,
        ]
    )
    start = truth + np.array([1.0, -1.0, 2.0, 1.0, -0.5, -0.3])
    fit, residual = moving_circle_kernel(points, start, 12)
    np.testing.assert_allclose(fit[:2], truth[:2], atol=0.05)
    np.testing.assert_allclose(fit[4], truth[4], atol=0.05)
    assert residual < 0.05


@pytest.mark.parametrize("dilate_px", [1, 3, 5])
def test_dilation_is_the_largest_value_around(dilate_px: int) -> None:
    image = np.random.default_rng(dilate_px).random((30, 40)) < 0.05
    flow = np.where(image, 1.0, 0.0)[None].repeat(2, axis=0)
    label, arcs = find_arcs(image, flow, dilate_px, 1)
    grown = ndimage.maximum_filter(image, size=dilate_px)
    expected, count = ndimage.label(grown, np.ones((3, 3)))
    assert len(arcs) == count
    np.testing.assert_array_equal(label, np.where(image, expected, 0))
    for arc in arcs:
        row, column = np.nonzero(label == arc.label)
        np.testing.assert_allclose(arc.center_px, [column.mean(), row.mean()])


def test_arcs_pair_along_their_motion_only() -> None:
    def arc(x: float, y: float, u: float, v: float) -> Arc:
        return Arc(1, np.array([x, y]), np.array([u, v]))

    behind, before = arc(10.0, 10.0, 1.0, 0.0), arc(22.0, 10.0, 1.0, 0.1)
    assert pair_arcs([behind], [before], 30.0, 21.0) == [(behind, before)]
    assert pair_arcs([behind], [arc(22.0, 10.0, 0.0, 1.0)], 30.0, 21.0) == []
    assert pair_arcs([behind], [arc(10.0, 22.0, 1.0, 0.0)], 30.0, 21.0) == []
    assert pair_arcs([behind], [arc(40.0, 10.0, 1.0, 0.0)], 30.0, 21.0) == []
    assert pair_arcs([], [before], 30.0, 21.0) == []


def test_time_surface_against_its_formula() -> None:
    rng = np.random.default_rng(8)
    t = np.sort(rng.integers(0, 50_000, 300))
    x, y = rng.integers(0, 8, (2, 300)).astype(np.uint16)
    p = rng.random(300) < 0.5
    start = (rng.random((8, 8)) < 0.3).astype(np.float32)
    surface = TimeSurface(start, 20_000.0)
    surface.absorb(EventPacket(x, y, p, t, 0, 60_000, (8, 8)))
    expected = np.where(start > 0.5, 1.0, -1.0) * math.exp(-60_000 / 20_000)
    for i in range(300):
        expected[y[i], x[i]] = (1.0 if p[i] else -1.0) * math.exp(-(60_000 - t[i]) / 20_000)
    np.testing.assert_allclose(surface.values, 0.5 + 0.5 * expected, atol=1e-5)


def test_a_time_surface_goes_on_for_many_time_constants() -> None:
    zeros = np.zeros(1, np.uint16)
    surface = TimeSurface(np.zeros((2, 2), np.float32), 1_000.0)
    for last_us in (500, 30_000, 200_000):
        event = EventPacket(zeros, zeros, zeros == 0, np.array([last_us - 100]), 0, last_us, (2, 2))
        surface.absorb(event)
        assert surface.values[0, 0] == pytest.approx(0.5 + 0.5 * math.exp(-0.1), abs=1e-5)
        assert surface.values[1, 1] == pytest.approx(
            0.5 - 0.5 * math.exp(-last_us / 1_000), abs=1e-5
        )


def test_slices_are_the_same_however_the_stream_is_cut() -> None:
    rng = np.random.default_rng(9)
    t = np.sort(rng.integers(0, 20_000, 200))
    zeros = np.zeros(200, np.uint16)
    whole = EventPacket(zeros, zeros, zeros > 0, t, 0, 25_000, (4, 4))
    expected = [part.t.tolist() for part in SliceBuffer(1_000).take(whole)]
    assert expected == [t[t // 1_000 == k].tolist() for k in np.unique(t // 1_000)]
    buffer, got = SliceBuffer(1_000), []
    edges = [0, *np.sort(rng.integers(0, 25_000, 30)).tolist(), 25_000]
    for start, end in itertools.pairwise(edges):
        first, last = np.searchsorted(t, (start, end))
        got += [part.t.tolist() for part in buffer.take(whole.part(first, last, start, end))]
    assert got == expected
