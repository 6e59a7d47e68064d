import numpy as np
import pytest

from spikingtac.denoise.blocks import (
    WORDS,
    combine_logits_kernel,
    from_blocks_kernel,
    quantise_kernel,
    smooth_kernel,
    to_blocks_kernel,
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
@pytest.mark.parametrize("full", [False, True])
def test_smoothing_equals_its_plain_twin(shape, full):
    random = np.random.default_rng(0)
    levels = np.full(shape, 255, np.uint8) if full else random.integers(0, 256, shape, np.uint8)
    smooth = np.empty(shape, np.uint16)
    smooth_kernel(levels, smooth, np.empty(shape[1] + 4, np.uint16))
    weights = np.array([1, 4, 6, 4, 1])
    padded = np.pad(levels, 2, mode="edge").astype(np.int64)
    for y, x in np.ndindex(shape):
        assert smooth[y, x] == weights @ padded[y : y + 5, x : x + 5] @ weights


@pytest.mark.parametrize("fold", [1, 2, 4, 8])
def test_blocks_equal_their_plain_twin_and_come_back(fold):
    rows, columns = 3, 5
    random = np.random.default_rng(0)
    levels = random.integers(0, 256, (rows * fold, columns * fold), np.uint8)
    blocks = np.zeros((rows, columns, fold**2 + fold), np.uint8)
    word = WORDS[fold]
    tight = np.zeros((rows, columns, fold**2), np.uint8)
    to_blocks_kernel(levels.view(word), tight.view(word))
    for row, column, channel in np.ndindex(tight.shape):
        y, x = row * fold + channel // fold, column * fold + channel % fold
        assert tight[row, column, channel] == levels[y, x]
    blocks[:, :, : fold**2] = tight
    back = np.zeros_like(levels)
    from_blocks_kernel(blocks.view(word), back.view(word))
    assert np.array_equal(back, levels)


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
