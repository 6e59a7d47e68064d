"""The kernels of slip against the same sums written plainly, marker by marker."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.touch.slip import features as slip
from spikingtac.touch.slip.features import LEAST_ARM, LEAST_SQUARE, SIZE, WIDTHS
from spikingtac.touch.slip.stream import FeatureStream

Array = np.ndarray
PITCH = 37.0
SPANS_S = np.array(slip.SPANS_US) / 1e6


def grid(rows: int = 8, columns: int = 8) -> Array:
    x, y = np.meshgrid(np.arange(columns) * PITCH, np.arange(rows) * PITCH)
    return np.column_stack([x.ravel(), y.ravel()]) + 30.0


def told(now: Array, before: Array) -> Array:
    out = np.empty(slip.FIRST_MOTION)
    slip.slip_features_kernel(now, before, SPANS_S, out)
    return out


def summary(places: Array, moved: Array) -> Array:
    square = (moved**2).sum(axis=1) + LEAST_SQUARE
    center = (square[:, None] * places).sum(axis=0) / square.sum()
    away = places - center
    shifts, growths, turns = [], [], []
    for width in WIDTHS:
        weight = np.exp(-0.5 * (away**2).sum(axis=1) / width**2)
        weight /= weight.sum()
        arm = weight @ (away**2).sum(axis=1) + LEAST_ARM
        shifts.append(weight @ moved)
        growths.append(weight @ (moved * away).sum(axis=1) / arm)
        turns.append(weight @ (away[:, 0] * moved[:, 1] - away[:, 1] * moved[:, 0]) / arm)
    return np.concatenate([np.ravel(shifts), growths, turns, center])


def features(now: Array, before: Array, spans_s: Array) -> Array:
    shift, growth, turn = now[:8].reshape(4, 2), now[8:12], now[12:16]
    length = np.sqrt((shift**2).sum(axis=1))
    total = np.sqrt(length[1] ** 2 + growth[1] ** 2 + turn[1] ** 2) + slip.SCATTER
    along = shift[1] / length[1] if length[1] > 0 else np.array([1.0, 0.0])
    others = [0, 2, 3]
    out = [np.log(total / slip.SCATTER), length[1] / total, growth[1] / total, abs(turn[1]) / total]
    out += [length[k] / (length[1] + slip.SCATTER) for k in others]
    out += [growth[k] * np.sign(growth[1]) / (abs(growth[1]) + slip.SCATTER) for k in others]
    out += [abs(turn[k]) / (abs(turn[1]) + slip.SCATTER) for k in others]
    for row, span_s in zip(before, spans_s, strict=True):
        change = now - row
        size = np.sqrt((change[:16] ** 2).sum() / 4)
        noisy = size + slip.CHANGE_SCATTER
        moved = change[:8].reshape(4, 2)
        out += [np.log(size / (span_s * slip.USUAL_SPEED) + slip.LEAST_SPEED)]
        out += (moved @ along / noisy).tolist()
        out += [abs(along[0] * moved[1, 1] - along[1] * moved[1, 0]) / noisy]
        out += [change[9] / noisy, change[13] * np.sign(turn[1]) / noisy]
        out += [change[11] / noisy, change[8] / noisy]
        out += [slip.CENTER_SHARE * (change[16:] @ along) / (size / total + slip.CENTER_SLACK)]
    return np.clip(out, -slip.LARGEST, slip.LARGEST)


def own_features(places: Array, motion: Array, now: Array, elapsed_s: float) -> Array:
    mine = summary(places, motion)
    shift, growth, turn = mine[:8].reshape(4, 2), mine[8:12], mine[12:16]
    size = np.sqrt((mine[:16] ** 2).sum() / 4)
    noisy, known = size + slip.CHANGE_SCATTER, size / (size + slip.SLIGHT)
    length, strength = np.sqrt((shift**2).sum(axis=1)), np.sqrt((now[2:4] ** 2).sum())
    along = shift[1] / length[1] if length[1] > 0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    away = mine[16:] - now[16:]
    out = [np.log(size / (elapsed_s * slip.USUAL_SPEED) + slip.LEAST_SPEED)]
    out += (length / noisy).tolist() + (growth[:3] / noisy).tolist()
    out += (abs(turn[:3]) / noisy).tolist()
    out += [slip.AWAY_SCALE * known * (away @ along), slip.AWAY_SCALE * known * abs(away @ across)]
    out += [known * (now[2:4] @ along) / (strength + slip.SLIGHT)]
    return np.clip(out, -slip.LARGEST, slip.LARGEST)


@pytest.mark.parametrize("shape", [(8, 8), (3, 5), (1, 2)])
@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0])
def test_a_motion_about_its_own_centre_has_the_features_that_its_sums_say(
    shape: tuple[int, int], scale: float
) -> None:
    rng, places = np.random.default_rng(11), grid(*shape) / PITCH
    motion = scale * rng.normal(size=places.shape)
    now, found = summary(places, rng.normal(size=places.shape)), np.empty(slip.MOTION_FEATURES)
    slip.own_motion_kernel(places, motion, now, 20_000, found)
    expected = own_features(places, motion, now, 0.02)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-14)


def test_the_stream_looks_at_the_motions_of_the_last_spans() -> None:
    rng, reference = np.random.default_rng(12), grid()
    moved = np.cumsum(rng.normal(size=(150, *reference.shape)), axis=0)
    stream = FeatureStream(reference)
    found = [stream.update(k * 1_000, row) for k, row in enumerate(moved)][-1]
    assert found is not None
    places, now = reference / PITCH, summary(reference / PITCH, moved[-1] / PITCH)
    for number, span_us in enumerate(slip.MOTION_SPANS_US):
        before = moved[149 - span_us // 1_000]
        expected = own_features(places, (moved[-1] - before) / PITCH, now, span_us / 1e6)
        first = slip.FIRST_MOTION + number * slip.MOTION_FEATURES
        np.testing.assert_allclose(found[first : first + slip.MOTION_FEATURES], expected, rtol=1e-9)


@pytest.mark.parametrize("shape", [(8, 8), (3, 5), (1, 2)])
@pytest.mark.parametrize("scale", [0.0, 1e-3, 5.0])
def test_a_field_is_summarised_as_its_sums_say(shape: tuple[int, int], scale: float) -> None:
    places, found = grid(*shape) / PITCH, np.empty(SIZE)
    moved = scale / PITCH * np.random.default_rng(3).normal(size=places.shape)
    slip.field_summary_kernel(places, moved, found)
    np.testing.assert_allclose(found, summary(places, moved), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_features_are_the_ratios_that_they_are_said_to_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now = rng.normal(size=SIZE)
    before = rng.normal(size=(len(SPANS_S), SIZE)) * (0.1 + seed)
    expected = features(now, before, SPANS_S)
    assert len(expected) == slip.FIRST_MOTION
    np.testing.assert_allclose(told(now, before), expected, rtol=1e-10)


def test_a_field_at_rest_has_features() -> None:
    nothing, before = np.zeros(SIZE), np.zeros((len(SPANS_S), SIZE))
    found = told(nothing, before)
    np.testing.assert_allclose(found, features(nothing, before, SPANS_S))
    assert np.isfinite(found).all()


def test_spans_begin_at_the_last_frame_before_them() -> None:
    rng, capacity = np.random.default_rng(7), 64
    times, summaries = np.cumsum(rng.integers(500, 6_000, 300)), rng.normal(size=(300, SIZE))
    slots, rows = np.zeros(capacity, np.int64), np.zeros((capacity, SIZE))
    spans = np.array([10_000, 40_000, 400_000])  # the last is longer than what is remembered
    starts, before = np.zeros(3, np.int64), np.zeros((3, SIZE))
    for k in range(300):
        slots[k % capacity], rows[k % capacity] = times[k], summaries[k]
        slip.spans_kernel(slots, rows, k + 1, spans, starts, before)
        oldest = max(0, k + 1 - capacity)
        at = [max(np.searchsorted(times, times[k] - span, "right") - 1, oldest) for span in spans]
        np.testing.assert_array_equal(starts, at)
        np.testing.assert_array_equal(before, summaries[at])
