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

_MARKS_PER_WORD = 8
"""One-byte marks in a 64-bit word."""

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
        self._words = np.zeros(width // _MARKS_PER_WORD + 1, np.uint64)
        self._white = np.zeros(width + 2, np.uint8)
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
        line = (self._words.view(np.uint8), self._words)
        count = _find_runs_kernel(state_map, self._threshold, self._white, line, self._runs)
        _sum_runs_kernel(state_map, self._runs[:count], self._sums)
        _join_runs_kernel(self._runs[:count], self._parent)
        blobs = _gather_kernel(self._runs[:count], self._parent, self._sums, state_map.shape)
        return self._chosen(self._sums[:blobs])

    def _chosen(self, sums: NDArray[np.float64]) -> Blobs:
        area = sums[:, 0]
        keep = (area >= self._config.min_area_px) & (area <= self._config.max_area_px)
        chosen = sums[keep]
        return Blobs(
            center_px=chosen[:, 2:4] / chosen[:, 1:2],
            area_px=chosen[:, 0],
            mass=chosen[:, 1],
            cut=chosen[:, 4] > 0,
        )


@njit(cache=True)
def _find_runs_kernel(
    state_map: NDArray[np.float32],
    threshold: float,
    white: NDArray[np.uint8],
    line: tuple[NDArray[np.uint8], NDArray[np.uint64]],
    runs: NDArray[np.int32],
) -> int:
    # runs: row, first column, column after the last. A row's changes of level are marked in two
    # vector passes and looked through eight at a time: the words share the marks' memory. The
    # first and the last of white lie outside of the row.
    changes, words = line
    height, width = state_map.shape
    count = 0
    for y in range(height):
        row = state_map[y]
        for x in range(width):
            white[x + 1] = np.uint8(row[x] >= threshold)
        for x in range(width + 1):
            changes[x] = white[x] ^ white[x + 1]
        side = 1
        for word in range(words.size):
            if words[word] == 0:
                continue
            for x in range(word * _MARKS_PER_WORD, (word + 1) * _MARKS_PER_WORD):
                if changes[x]:
                    runs[count, 0], runs[count, side] = y, x
                    count += side - 1
                    side = 3 - side
    return count


@njit(cache=True)
def _sum_runs_kernel(
    state_map: NDArray[np.float32], runs: NDArray[np.int32], sums: NDArray[np.float64]
) -> None:
    for run in range(len(runs)):
        y, first, last = runs[run, 0], runs[run, 1], runs[run, 2]
        mass = moment = 0.0
        for x in range(first, last):
            mass += state_map[y, x]
            moment += state_map[y, x] * x
        sums[run, 0], sums[run, 1], sums[run, 2] = last - first, mass, moment
        sums[run, 3] = mass * y


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
