"""Find stretches of zero bytes, or of 0xFF, where words should be.

A lost sector reads as zeros, erased flash as ones. Both are words of a RAW format: zeros are events
at (0, 0) in EVT2, so that they must be found before they are decoded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FILL_BYTES = 64
"""Stretches from this length on are no words (ours: no sensor sends 16 events of one pixel in one
microsecond, or so many empty words)."""

_SAMPLE_STRIDE = 4
"""Every fourth of the 64-bit numbers is looked at: 39 bytes of fill always hold one of them."""

_ONES = np.uint64((1 << 64) - 1)


def may_be_filled(data: NDArray[np.uint8]) -> bool:
    """Return whether bytes may hold a stretch of fill; quick, for it is asked of all bytes."""
    samples = data[: len(data) // 8 * 8].view(np.uint64)[::_SAMPLE_STRIDE]
    return bool((samples == 0).any() or (samples == _ONES).any())


def filled_words(words: NDArray[Any], in_fill: bool) -> list[tuple[int, int]]:
    """Return the stretches of words (first, last exclusive) that are nothing but fill.

    Args:
        words: ``(n,)`` words.
        in_fill: Whether the words before ended in a stretch of fill, which may go on.
    """
    least = -(-FILL_BYTES // words.dtype.itemsize)
    found: list[tuple[int, int]] = []
    for fill in _fills(words):
        same = np.concatenate(([False], words == fill, [False]))
        edges = np.flatnonzero(same[1:] != same[:-1]).reshape(-1, 2)
        for first, last in edges.tolist():
            if last - first >= least or (in_fill and first == 0):
                found.append((first, last))
    return sorted(found)


def fill_at_end(words: NDArray[Any]) -> int:
    """Return how many of the last words may begin a stretch of fill, fewer than make one."""
    most = FILL_BYTES // words.dtype.itemsize
    tail = words[-most:]
    for fill in _fills(words):
        if len(tail) and tail[-1] == fill:
            others = np.flatnonzero(tail[::-1] != fill)
            return int(others[0]) if len(others) else len(tail)
    return 0


def _fills(words: NDArray[Any]) -> tuple[int, int]:
    return 0, int(np.iinfo(words.dtype).max)
