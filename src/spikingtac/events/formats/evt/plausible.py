"""Which word format do some bytes look like? The header may be wrong or missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CANDIDATES = ("evt3", "evt2", "evt21/little", "evt21/legacy", "evt21/big")
FOREIGN_SHARE = 0.15
"""Share of implausible words from which on a claimed format is doubted."""

SOUND_SHARE = 0.04
"""Share of implausible words up to which another format is believed instead."""

_EVT3_UNKNOWN = np.array([kind in (0x1, 0x9, 0xB, 0xC, 0xD) for kind in range(16)])
_EVT2_UNKNOWN = np.array([kind not in (0, 1, 8, 0xA, 0xD, 0xE, 0xF) for kind in range(16)])
_STEP_LIMIT = 1 << 14
"""Largest step of the upper 28 bits that is plausible within a sample: one second."""


def implausible_share(data: bytes, candidate: str, size: tuple[int, int] | None) -> float:
    """Return the share of implausible words, 1 where no evidence supports the candidate."""
    width, height = size or (1 << 11, 1 << 11)
    encoding, _, order = candidate.partition("/")
    if encoding == "evt3":
        return _evt3_share(np.frombuffer(data, "<u2", len(data) // 2), width, height)
    if encoding == "evt2":
        return _evt2_share(np.frombuffer(data, "<u4", len(data) // 4), None, width, height)
    halves = np.frombuffer(data, ">u4" if order == "big" else "<u4", len(data) // 8 * 2)
    head = 1 if order == "little" else 0
    return _evt2_share(halves[head::2], halves[1 - head :: 2], width, height)


def best_candidate(
    data: bytes, size: tuple[int, int] | None, candidates: tuple[str, ...] = CANDIDATES
) -> tuple[str, float]:
    """Return the candidate with the least implausible share, and that share."""
    shares = {name: implausible_share(data, name, size) for name in candidates}
    name = min(shares, key=lambda key: shares[key])
    return name, shares[name]


def _evt3_share(words: NDArray[np.uint16], width: int, height: int) -> float:
    words = words[words != 0x9999]
    kind, value = words >> 12, words & 0xFFF
    address = value & 0x7FF
    bad = _EVT3_UNKNOWN[kind] | ((kind == 0) & (address >= height))
    bad |= ((kind == 2) | (kind == 3)) & (address >= width)
    if not len(words) or not (kind == 8).any():
        return 1.0
    clock = np.flatnonzero((kind == 6) | (kind == 8))
    low = kind[clock] == 6
    falls = low[1:] & low[:-1] & (np.diff(value[clock].astype(np.int64)) < -64)
    steps = np.diff(value[kind == 8].astype(np.int64)) % (1 << 12)
    fallen = np.count_nonzero(falls) + np.count_nonzero(steps > 1 << 8)
    return (np.count_nonzero(bad) + fallen) / len(words)


def _evt2_share(
    heads: NDArray[np.uint32], masks: NDArray[np.uint32] | None, width: int, height: int
) -> float:
    kind = heads >> 28
    event = kind <= 1
    column, row = (heads >> 11) & 0x7FF, heads & 0x7FF
    bad = _EVT2_UNKNOWN[kind] | (event & ((column >= width) | (row >= height)))
    if masks is not None:
        bad |= event & ((masks == 0) | (column % 32 != 0))
    if not len(heads) or not (kind == 8).any():
        return 1.0
    clock = np.flatnonzero(event | (kind == 8))
    low, high = event[clock], (heads[clock] >> 22) & 0x3F
    falls = low[1:] & low[:-1] & (np.diff(high.astype(np.int64)) < -8)
    steps = np.diff((heads[kind == 8] & 0xFFFFFFF).astype(np.int64)) % (1 << 28)
    fallen = np.count_nonzero(falls) + np.count_nonzero(steps > _STEP_LIMIT)
    return (np.count_nonzero(bad) + fallen) / len(heads)
