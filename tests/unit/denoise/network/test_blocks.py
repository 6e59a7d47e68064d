import numpy as np
import pytest

from spikingtac.denoise.blocks import (
    combine_logits_kernel,
    fold_blocks,
    folded_shape,
    quantise_kernel,
    smooth_kernel,
    unfold_blocks,
)

LOGISTIC_ERROR = 0.022
SHAPES = [((16, 16), (16, 16)), ((17, 33), (32, 48)), ((1, 1), (16, 16)), ((70, 10), (80, 16))]


@pytest.mark.parametrize(("shape", "padded"), SHAPES)
def test_bytes_equal_their_plain_twin(shape, padded):
    state_map = np.random.default_rng(0).random(shape, np.float32)
    state_map.flat[0], state_map.flat[-1] = 0.0, 1.0
    levels = np.empty(padded, np.uint8)
    quantise_kernel(state_map, levels)
    expected = np.floor(state_map * np.float32(255) + np.float32(0.5)).astype(np.uint8)
    more = [(0, wide - narrow) for wide, narrow in zip(padded, shape, strict=True)]
    assert np.array_equal(levels, np.pad(expected, more, mode="edge"))


@pytest.mark.parametrize("shape", [(16, 16), (17, 33), (1, 1), (2, 3)])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
@pytest.mark.parametrize("full", [False, True])
def test_smoothing_equals_its_plain_twin(shape, full, kind):
    random = np.random.default_rng(0)
    levels = np.full(shape, 255, np.uint8) if full else random.integers(0, 256, shape, np.uint8)
    levels = levels if kind == np.uint16 else levels.astype(kind)
    smooth = np.empty(shape, kind)
    smooth_kernel(levels, smooth, np.empty(shape[1] + 4, kind))
    weights = np.array([1, 4, 6, 4, 1])
    padded = np.pad(levels, 2, mode="edge").astype(np.int64)
    for y, x in np.ndindex(shape):
        assert smooth[y, x] == weights @ padded[y : y + 5, x : x + 5] @ weights


def test_the_answer_is_the_logistic_function_of_change_and_evidence():
    random = np.random.default_rng(0)
    fold, size, step, zero = 4, (10, 14), 0.07, 130.0
    change = random.integers(0, 256, (12, 16), np.uint8)
    trust = random.integers(0, 256, (3, 4), np.uint8)
    smooth = random.integers(0, 65_281, (12, 16)).astype(np.uint16)
    out = np.empty(size, np.float32)
    combine_logits_kernel(change, trust, smooth, (step, zero), np.empty(16, np.float32), out)
    decided = 0
    for y, x in np.ndindex(size):
        trusted = max(0.0, step * (trust[y // fold, x // fold] - zero))
        logit = step * (change[y, x] - zero) + trusted * (smooth[y, x] / 65_280 - 0.5)
        assert out[y, x] == pytest.approx(1.0 / (1.0 + np.exp(-logit)), abs=LOGISTIC_ERROR)
        if abs(logit) > 1e-4:
            decided += 1
            assert (out[y, x] >= 0.5) == (logit >= 0.0)
    assert decided > 130


@pytest.mark.parametrize("shape", [(16, 16), (32, 48), (17, 33), (1, 1), (70, 10)])
@pytest.mark.parametrize("fold", [1, 2, 8])
def test_folding_equals_its_plain_twin_and_comes_back(shape, fold):
    state_map = np.random.default_rng(0).random(shape, np.float32)
    folded = fold_blocks(state_map, fold, 2 * fold)
    assert folded.shape == folded_shape(shape, fold, 2 * fold)
    for channel, row, column in np.ndindex(folded.shape):
        y = min(row * fold + channel // fold, shape[0] - 1)
        x = min(column * fold + channel % fold, shape[1] - 1)
        assert folded[channel, row, column] == state_map[y, x]
    assert np.array_equal(unfold_blocks(folded, shape), state_map)
