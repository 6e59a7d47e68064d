"""The baselines against plain Python, on random and on edge arrays."""

import math

import numpy as np
import pytest

from spikingtac.types import EventPacket
from spikingtac_paper.baselines.ekalibr import moving_circle
from spikingtac_paper.baselines.evetac import TURN_RATIO, attraction, regularizer
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
    pull, support = attraction(*events.T, center, (3.0, 14.0))
    expected = plain_attraction(events.astype(float), center, 3.0, 14.0, TURN_RATIO * 14.0)
    np.testing.assert_allclose(pull, expected[0], atol=1e-9)
    np.testing.assert_array_equal(support, expected[1])


def test_regularizer() -> None:
    rest = np.array([[37.0 * i, 37.0 * j] for i in range(3) for j in range(3)])
    distance = np.linalg.norm(rest[:, None] - rest, axis=2)
    distance[(distance == 0.0) | (distance > 60.0)] = np.nan
    center = rest + np.random.default_rng(2).normal(0.0, 2.0, rest.shape)
    told = regularizer(center, distance)
    for i in range(9):
        near = np.flatnonzero(np.isfinite(distance[i]))
        total = np.zeros(2)
        for j in near:
            offset = center[j] - center[i]
            total += 4.0 * offset * (offset @ offset - distance[i, j] ** 2)
        np.testing.assert_allclose(told[i], 8.0 / len(near) * total, rtol=1e-9)
    np.testing.assert_allclose(regularizer(rest, distance), 0.0, atol=1e-6)


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
    fit, residual = moving_circle(points, truth + np.array([1.0, -1.0, 2.0, 1.0, -0.5, -0.3]), 12)
    np.testing.assert_allclose(fit[:2], truth[:2], atol=0.05)
    np.testing.assert_allclose(fit[4], truth[4], atol=0.05)
    assert residual < 0.05


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
