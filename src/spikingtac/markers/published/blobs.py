"""Blobs of a state map: where bright, 8-connected regions lie, to a fraction of a pixel.

The paper extracts marker centroids "using a Blob Detection algorithm" (section IV-B) and says no
more. Ours is exact for one threshold: run-length encoded connected components by union-find.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

_BITS = 64
"""Bits in a machine word, and one-byte marks that become one."""

_PACK = np.uint64(0x0102040810204080)
"""Times this, eight bytes of 0 or 1 become the eight bits of the highest byte."""

_DE_BRUIJN = 0x03F79D71B4CB0A89
"""A de Bruijn sequence: a power of two times this has six highest bits that tell which it was
(Leiserson, Prokop, Randall, "Using de Bruijn sequences to index a 1 in a computer word", 1998)."""


def _bit_table() -> NDArray[np.int64]:
    table = np.zeros(_BITS, np.int64)
    for bit in range(_BITS):
        table[((_DE_BRUIJN << bit) & (2**_BITS - 1)) >> (_BITS - 6)] = bit
    return table


_BIT_OF = _bit_table()
"""Those six bits -> which power of two."""

_FIELDS = 5
"""Sums per run and blob: area, mass, mass * x, mass * y, number of runs at the border."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BlobConfig:
    """What counts as a blob; all values are ours, the paper gives none.

    Attributes:
        threshold: Level from which a pixel belongs to a blob. Half-way between ground and marker
            keeps a blurred disc's area, and on a binary map any level in (0, 1] is the same.
        min_area_px: Smallest area, pixels: 20 is an eighth of the paper's marker (radius 7 px, area
            154), and noise at 1 Hz/px hardly ever makes 20 connected pixels behind a median filter.
        max_area_px: Largest area, pixels: two touching markers of radius 15 px still pass, a lit
            half of the sensor does not.
    """

    threshold: float = 0.5
    min_area_px: float = 20.0
    max_area_px: float = 2_000.0

    def __post_init__(self) -> None:
        if not 0.0 < self.threshold <= 1.0:
            raise ConfigError(f"threshold is {self.threshold}, valid is 0 < threshold <= 1")
        if not 0.0 <= self.min_area_px <= self.max_area_px:
            raise ConfigError(
                f"min_area_px {self.min_area_px} and max_area_px {self.max_area_px} must be "
                "ordered and not negative"
            )


@dataclass(frozen=True, slots=True)
class Blobs:
    """The blobs of one map, in order of their first pixel (row by row).

    Attributes:
        center_px: ``(n, 2)`` centroids (x, y), weighted with the map's values, px.
        area_px: ``(n,)`` number of pixels at or above the threshold.
        mass: ``(n,)`` sum of the map over those pixels.
        cut: ``(n,)`` True where the blob touches the border: its centroid is biased inwards.
    """

    center_px: NDArray[np.float64]
    area_px: NDArray[np.float64]
    mass: NDArray[np.float64]
    cut: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.area_px)


class BlobDetector:
    """Finds the blobs of maps of one size; its buffers are reused, its results are not.

    Touching markers come out as one blob of their joint area: the caller, who knows the size of a
    marker, sees it in ``area_px``.

    Example:
        >>> import numpy as np
        >>> state_map = np.zeros((20, 20), np.float32)
        >>> state_map[5:10, 8:13] = 1.0
        >>> BlobDetector((20, 20)).detect(state_map).center_px.tolist()
        [[10.0, 7.0]]
    """

    def __init__(self, size: tuple[int, int], config: BlobConfig | None = None) -> None:
        """Prepare for maps of a size.

        Args:
            size: ``(width, height)``, px.
            config: What counts as a blob.
        """
        width, height = size
        most_runs = height * ((width + 1) // 2)
        self._config = config or BlobConfig()
        self._shape = (height, width)
        # Single precision, as the map: 0.2 in double precision lies above 0.2 in the map.
        self._threshold: Any = np.float32(self._config.threshold)
        # Room for one more pixel, which is never white: so every run ends within its row.
        self._white = np.zeros((width // _BITS + 1) * _BITS, np.uint8)
        self._runs = np.empty((most_runs, 3), np.int32)
        self._parent = np.empty(most_runs, np.int32)
        self._sums = np.empty((most_runs, _FIELDS), np.float64)

    def detect(self, state_map: NDArray[np.float32]) -> Blobs:
        """Return the blobs of a map.

        Args:
            state_map: ``(height, width)`` float32.

        Raises:
            ConfigError: The map has another shape than the detector was made for.
        """
        if state_map.shape != self._shape:
            raise ConfigError(
                f"the map has shape {state_map.shape}, this detector was made for {self._shape}; "
                "make one for each sensor"
            )
        # Cut anew each time: a view that is stored would be torn off by a deep copy.
        words = self._white.view(np.uint64)
        count = _find_runs_kernel(state_map, self._threshold, self._white, words, self._runs)
        _sum_runs_kernel(state_map, self._runs[:count], self._sums)
        _join_runs_kernel(self._runs[:count], self._parent)
        blobs = _gather_kernel(self._runs[:count], self._parent, self._sums, state_map.shape)
        return self._chosen(self._sums[:blobs])

    def _chosen(self, sums: NDArray[np.float64]) -> Blobs:
        config, count = self._config, len(sums)
        center_px, area_px, mass = np.empty((count, 2)), np.empty(count), np.empty(count)
        cut = np.empty(count, np.bool_)
        limits = config.min_area_px, config.max_area_px
        kept = _choose_kernel(sums, limits, center_px, area_px, mass, cut)
        return Blobs(center_px[:kept], area_px[:kept], mass[:kept], cut[:kept])


@njit(cache=True)
def _find_runs_kernel(
    state_map: NDArray[np.float32],
    threshold: float,
    white: NDArray[np.uint8],
    words: NDArray[np.uint64],
    runs: NDArray[np.int32],
) -> int:
    # runs: row, first column, column after the last. A row's white pixels become bits, and the bits
    # where it changes are visited one by one: no branch depends on a single pixel, which no
    # processor could foresee. The words share the white pixels' memory.
    height, width = state_map.shape
    one, highest = np.uint64(1), np.uint64(_BITS - 1)
    changes = 0
    for y in range(height):
        row = state_map[y]
        for x in range(width):
            white[x] = np.uint8(row[x] >= threshold)
        before = np.uint64(0)
        for block in range(words.size // 8):
            bits = np.uint64(0)
            for k in range(8):
                eight = (words[8 * block + k] * _PACK) >> np.uint64(_BITS - 8)
                bits |= eight << np.uint64(8 * k)
            change = bits ^ ((bits << one) | before)
            before = bits >> highest
            while change:
                lowest = change & (~change + one)
                bit = _BIT_OF[(lowest * np.uint64(_DE_BRUIJN)) >> np.uint64(_BITS - 6)]
                runs[changes >> 1, 0] = y
                runs[changes >> 1, 1 + (changes & 1)] = _BITS * block + bit
                changes += 1
                change ^= lowest
    return changes >> 1


@njit(cache=True, fastmath=True, error_model="numpy")
def _sum_runs_kernel(
    state_map: NDArray[np.float32], runs: NDArray[np.int32], sums: NDArray[np.float64]
) -> None:
    for run in range(len(runs)):
        y, first, last = runs[run, 0], runs[run, 1], runs[run, 2]
        mass = moment = np.float32(0.0)
        for j in range(np.uint64(last - first)):
            level = state_map[np.uint64(y), np.uint64(first) + j]
            mass += level
            moment += level * np.float32(np.int32(j))
        sums[run, 0], sums[run, 1] = last - first, mass
        sums[run, 2], sums[run, 3] = moment + float(mass) * first, float(mass) * y


@njit(cache=True)
def _root_kernel(parent: NDArray[np.int32], run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True)
def _join_runs_kernel(runs: NDArray[np.int32], parent: NDArray[np.int32]) -> None:
    # Two cursors walk along neighbouring rows; the smaller index stays the root, which keeps the
    # blobs in the order of their first pixel.
    above = 0
    for run in range(len(runs)):
        parent[run] = run
        y, first, last = runs[run, 0], runs[run, 1], runs[run, 2]
        while above < run and runs[above, 0] < y - 1:
            above += 1
        while above < run and runs[above, 0] == y - 1 and runs[above, 2] < first:
            above += 1
        touching = above
        while touching < run and runs[touching, 0] == y - 1 and runs[touching, 1] <= last:
            one, other = _root_kernel(parent, touching), _root_kernel(parent, run)
            parent[max(one, other)] = min(one, other)
            touching += 1


@njit(cache=True)
def _gather_kernel(
    runs: NDArray[np.int32],
    parent: NDArray[np.int32],
    sums: NDArray[np.float64],
    shape: tuple[int, int],
) -> int:
    # A parent comes before its runs, so that the sums can be gathered in place, front to back, and
    # each visited entry of parent can be overwritten with its blob's number.
    blobs = 0
    for run in range(len(runs)):
        y, first, last = runs[run, 0], runs[run, 1], runs[run, 2]
        at_border = y == 0 or y == shape[0] - 1 or first == 0 or last == shape[1]
        if parent[run] == run:
            blob = blobs
            blobs += 1
            for k in range(4):
                sums[blob, k] = sums[run, k]
            sums[blob, 4] = 0.0
        else:
            blob = parent[parent[run]]
            for k in range(4):
                sums[blob, k] += sums[run, k]
        sums[blob, 4] += at_border
        parent[run] = blob
    return blobs


@njit(cache=True)
def _choose_kernel(
    sums: NDArray[np.float64],
    limits: tuple[float, float],
    center_px: NDArray[np.float64],
    area_px: NDArray[np.float64],
    mass: NDArray[np.float64],
    cut: NDArray[np.bool_],
) -> int:
    kept = 0
    for blob in range(len(sums)):
        if limits[0] <= sums[blob, 0] <= limits[1]:
            area_px[kept], mass[kept] = sums[blob, 0], sums[blob, 1]
            center_px[kept, 0] = sums[blob, 2] / sums[blob, 1]
            center_px[kept, 1] = sums[blob, 3] / sums[blob, 1]
            cut[kept] = sums[blob, 4] > 0.0
            kept += 1
    return kept
