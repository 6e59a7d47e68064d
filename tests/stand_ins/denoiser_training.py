"""Tiny clips for tests of training and export: a disc that moves, no simulator."""

import numpy as np

from spikingtac.state_map.binary import paint_binary_discs
from spikingtac_paper.training.dataset import Clip
from stand_ins.random_packets import packet_of

SIZE = (64, 48)
RADIUS_PX = 7.0
SPAN_US = 400_000
MOVES = 40


def moving_disc(seed: int = 0) -> Clip:
    """A disc that moves along a random line; each pixel fires three times when it changes."""
    random = np.random.default_rng(seed)
    center, step = random.uniform(20, 28, 2), random.uniform(-0.3, 0.3, 2)
    shape = (SIZE, np.array([center]), np.array([RADIUS_PX]))
    before = paint_binary_discs(*shape)
    start, rows = before.copy(), []
    for move in range(1, MOVES + 1):
        after = paint_binary_discs(SIZE, np.array([center + move * step]), np.array([RADIUS_PX]))
        y, x = np.nonzero(after != before)
        for repeat in range(3):
            t = np.full(len(x), move * SPAN_US // (MOVES + 1) + 100 * repeat)
            rows.append(np.stack([t, x, y, after[y, x] > 0.5]))
        before = after
    return Clip(f"disc-{seed}", packet_of(*np.concatenate(rows, axis=1), SIZE, (0, SPAN_US)), start)


def noisy_maps(count: int = 4) -> list[np.ndarray]:
    random = np.random.default_rng(3)
    clean = moving_disc().start
    return [
        np.where(random.random(clean.shape) < 0.1, 1 - clean, clean).astype(np.float32)
        for _ in range(count)
    ]
