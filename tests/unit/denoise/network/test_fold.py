import numpy as np
import pytest

from spikingtac.denoise.fold import (
    evidence_kernel,
    fold_kernel,
    folded_shape,
    unfold_kernel,
)


def folded_slowly(state_map: np.ndarray, fold: int, multiple_px: int) -> np.ndarray:
    height, width = state_map.shape
    shape = folded_shape((height, width), fold, multiple_px)
    out = np.empty(shape, np.float32)
    for channel, row, column in np.ndindex(shape):
        y = min(row * fold + channel // fold, height - 1)
        x = min(column * fold + channel % fold, width - 1)
        out[channel, row, column] = state_map[y, x]
    return out


def unfolded_slowly(folded: np.ndarray, shape: tuple[int, int], fold: int) -> np.ndarray:
    out = np.empty(shape, np.float32)
    for y, x in np.ndindex(shape):
        out[y, x] = folded[fold * (y % fold) + x % fold, y // fold, x // fold]
    return out


@pytest.mark.parametrize("shape", [(16, 16), (32, 48), (17, 33), (1, 1), (70, 10)])
@pytest.mark.parametrize("fold", [1, 2, 8])
def test_folding_equals_its_plain_twin(shape, fold):
    state_map = np.random.default_rng(0).random(shape, np.float32)
    multiple_px = 2 * fold
    folded = np.empty(folded_shape(shape, fold, multiple_px), np.float32)
    fold_kernel(state_map, folded, fold)
    assert np.array_equal(folded, folded_slowly(state_map, fold, multiple_px))
    back = np.empty(shape, np.float32)
    unfold_kernel(folded, back, fold)
    assert np.array_equal(back, unfolded_slowly(folded, shape, fold))
    assert np.array_equal(back, state_map)


def test_folding_is_torchs_pixel_unshuffle():
    torch = pytest.importorskip("torch")
    state_map = np.random.default_rng(0).random((32, 48), np.float32)
    folded = np.empty((64, 4, 6), np.float32)
    fold_kernel(state_map, folded, 8)
    theirs = torch.nn.functional.pixel_unshuffle(torch.from_numpy(state_map)[None, None], 8)
    assert np.array_equal(folded, theirs[0].numpy())


@pytest.mark.parametrize("shape", [(16, 16), (17, 33), (1, 1), (2, 3)])
def test_smoothing_equals_its_plain_twin(shape):
    state_map = np.random.default_rng(0).random(shape, np.float32)
    smoothed = np.empty_like(state_map)
    evidence_kernel(state_map, smoothed, np.empty(shape[1] + 4, np.float32))
    weights = np.array([1, 4, 6, 4, 1]) / 16.0
    padded = np.pad(state_map, 2, mode="edge").astype(np.float64)
    for y, x in np.ndindex(shape):
        expected = weights @ padded[y : y + 5, x : x + 5] @ weights - 0.5
        assert smoothed[y, x] == pytest.approx(expected, abs=1e-6)
