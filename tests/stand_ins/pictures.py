"""Whether two pictures show the same, whatever fonts and compression they were made with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

# Pictures are compared in cells of this side, so that the smoothing of a line counts little.
CELL_PX = 8
MOST_DIFFERENT_CELLS = 0.02  # Share of the cells that may differ.
CELL_LEVELS = 24.0  # Grey levels of 255 from which on a cell differs.


def different_cells(one: Path, other: Path, frame: int = 0, later: int = 0) -> float:
    """Return the share of the cells that differ; 1 where the sizes do.

    Args:
        one: A picture or an animation.
        other: The same.
        frame: Which picture of an animation.
        later: How many pictures later the other animation shows it.
    """
    first, second = _cells(one, frame), _cells(other, frame + later)
    if first.shape != second.shape:
        return 1.0
    return float((np.abs(first - second).max(axis=2) > CELL_LEVELS).mean())


def _cells(path: Path, frame: int) -> np.ndarray:
    with Image.open(path) as picture:
        picture.seek(frame)
        rgb = np.asarray(picture.convert("RGB"), float)
    rows, columns = (length // CELL_PX for length in rgb.shape[:2])
    whole = rgb[: rows * CELL_PX, : columns * CELL_PX]
    return whole.reshape(rows, CELL_PX, columns, CELL_PX, 3).mean(axis=(1, 3))
