"""Features of slip and fields of forces against the same sums, written plainly."""

import numpy as np
import pytest

from spikingtac.touch.force.model import (
    AVERAGE_S,
    LONGEST_GAP_S,
    MEMORY_S,
    MEMORY_SHARES,
    PRIOR_S,
    FieldStream,
)
from spikingtac.touch.slip import features as slip

Array = np.ndarray
PLACES = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(5.0), np.arange(3.0))])


def test_fields_are_told_from_their_zero_with_their_past() -> None:
    """The zero as a mean of rests, and the memory marker by marker, in plain Python."""
    rng, radius = np.random.default_rng(3), 0.5
    stream, zero, rested_s, t_us = FieldStream(radius, 8, memory=True), np.zeros(8), PRIOR_S, 0
    means, seen, gaps = np.zeros((2, 8)), 0, 0
    for number in range(200):
        step_us = int(rng.integers(1_000, 250_000)) if number else 0
        t_us, step_s = t_us + step_us, 1e-6 * step_us
        frame = 0.3 + 0.1 * rng.normal(size=8) + 4.0 * (number % 3 == 2)
        away = frame - zero
        if (away * away).mean() < radius**2:
            seen += 1
            share_s = min(step_s, 0.1) if number else 0.1
            rested_s = min(rested_s + share_s, AVERAGE_S)
            zero = zero + share_s / rested_s * away
        found = stream.update(t_us, frame)
        fade = [1.0 - np.exp(-step_s / tau) for tau in MEMORY_S[:, 0]]
        if step_s > LONGEST_GAP_S:
            gaps += 1
            means = np.array([(1.0 - g) * row for g, row in zip(fade, means, strict=True)])
            fade = [0.0, 0.0]
        shares = MEMORY_SHARES[:, 0]
        kept = sum(c * (1.0 - g) * m for c, g, m in zip(shares, fade, means, strict=True))
        told = (frame - zero + kept) / (1.0 - sum(c * g for c, g in zip(shares, fade, strict=True)))
        means = np.array([m + g * (told - m) for g, m in zip(fade, means, strict=True)])
        np.testing.assert_allclose(found, told, rtol=1e-12, atol=1e-13)
    assert 100 < seen < 150
    assert gaps > 10


def plain_summary(moved: Array) -> Array:
    """Shifts, growths and turns over each width about the centre of the motion."""
    square = (moved**2).sum(axis=1) + slip.LEAST_SQUARE
    away = PLACES - (square[:, None] * PLACES).sum(axis=0) / square.sum()
    shifts, growths, turns = [], [], []
    for width in slip.WIDTHS:
        weight, shift, arm, growth, turn = 0.0, np.zeros(2), 0.0, 0.0, 0.0
        for (x, y), (u, v) in zip(away, moved, strict=True):
            share = np.exp(-0.5 * (x * x + y * y) / width**2)
            weight += share
            shift += share * np.array([u, v])
            arm += share * (x * x + y * y)
            growth += share * (u * x + v * y)
            turn += share * (x * v - y * u)
        arm = arm / weight + slip.LEAST_ARM
        shifts.append(shift / weight)
        growths.append(growth / weight / arm)
        turns.append(turn / weight / arm)
    return np.concatenate([np.ravel(shifts), growths, turns, PLACES[0] - away[0]])


@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0])
def test_a_field_is_summarised_as_its_sums_say(scale: float) -> None:
    moved = scale * np.random.default_rng(3).normal(size=(2, *PLACES.shape))
    found = slip.summaries(PLACES, moved)
    np.testing.assert_allclose(found, [plain_summary(one) for one in moved], rtol=1e-10, atol=1e-14)


def test_the_stream_looks_at_the_changes_and_motions_of_the_last_spans() -> None:
    moved = np.cumsum(np.random.default_rng(12).normal(size=(200, *PLACES.shape)), axis=0)
    stream, found = slip.FeatureStream(PLACES), None
    for k, row in enumerate(moved):
        found = stream.update(k * 1_000, row, wanted=k % 3 == 1)
    assert found is not None
    now = plain_summary(moved[-1])
    before = [moved[199 - span // 1_000] for span in (*slip.SPANS_US, *slip.MOTION_SPANS_US)]
    changes = np.array([plain_summary(one) for one in before[:4]])
    motions = np.array([plain_summary(moved[-1] - one) for one in before[4:]])
    shape, changed = slip.shape_features(now, changes)
    own = slip.motion_features(motions, now, np.array(slip.MOTION_SPANS_US) / 1e6)
    expected = np.concatenate([shape, changed.ravel(), own.ravel()])
    np.testing.assert_allclose(found, expected.clip(-6.0, 6.0), rtol=1e-8)
