"""Tracks whose every value is known in closed form."""

import numpy as np

from spikingtac.tracks import Tracks
from stand_ins.viewer import positions_px, reference_px

FIRST_US, STEP_US, HELD_MARKER = 7, 1_000, 9


def circling_tracks(
    estimates: int = 500, px_per_mm: float | None = None, off_px: float = 0.0
) -> Tracks:
    """Return tracks of the circling markers, one of them coasted, ``off_px`` to the right."""
    rest = reference_px().astype(np.float32)
    t_us = FIRST_US + STEP_US * np.arange(estimates, dtype=np.int64)
    placed = [positions_px(t) for t in t_us.tolist()]
    position = np.reshape(placed, (estimates, len(rest), 2)).astype(np.float32)
    position[..., 0] += off_px
    coasted = np.zeros((estimates, len(rest)), bool)
    coasted[:, HELD_MARKER] = True
    meta = {"grid": [8, 8]} | ({} if px_per_mm is None else {"px_per_mm": px_per_mm})
    confidence = np.where(coasted, 0.0, 0.9).astype(np.float32)
    return Tracks(t_us, position, position.copy(), position - rest, coasted, confidence, rest, meta)
