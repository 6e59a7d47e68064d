"""Blobs of a state map, to a fraction of a pixel, and which of them is which marker.

The paper extracts marker centroids "using a Blob Detection algorithm" (section IV-B) and says no
more. Ours are the 8-connected regions from one threshold on, by union-find.

Then a k-d tree is queried to match new centroids with identities from the preceding state within a
proximity threshold (section IV-B). The paper does not say what happens when two markers claim one
centroid. Here a pair is matched only where each is the other's nearest, so that no centroid ever
serves two markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.errors import ConfigError

UNMATCHED = -1  # What a marker without a centroid gets.

AREA, MASS, MOMENT_X, MOMENT_Y, AT_BORDER = range(5)  # Sums over the pixels of a blob.


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
        self._config = config or BlobConfig()
        self._shape = (height, width)
        # With a frame of ground, so that no pixel's neighbours lie outside.
        self._labels = np.zeros((height + 1, width + 2), np.int32)
        most = ((height + 1) // 2) * ((width + 1) // 2) + 1
        self._parent, self._number = np.zeros((2, most), np.int32)
        self._sums = np.empty((most, 5))

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
        config = self._config
        # Single precision, as the map: 0.2 in double precision lies above 0.2 in the map.
        threshold: Any = np.float32(config.threshold)
        count = _label_kernel(state_map, threshold, self._labels, self._parent)
        regions = self._parent[: count + 1], self._number
        blobs = _sum_kernel(state_map, self._labels, *regions, self._sums)
        sums = self._sums[:blobs]
        sums = sums[(sums[:, AREA] >= config.min_area_px) & (sums[:, AREA] <= config.max_area_px)]
        center_px = sums[:, MOMENT_X : MOMENT_Y + 1] / sums[:, MASS : MASS + 1]
        return Blobs(center_px, sums[:, AREA], sums[:, MASS], sums[:, AT_BORDER] > 0.0)


def associate(
    previous_px: NDArray[np.float64], detected_px: NDArray[np.float64], proximity_px: float
) -> NDArray[np.int64]:
    """Return for each marker the centroid that is its own, or :data:`UNMATCHED`.

    Args:
        previous_px: ``(m, 2)`` markers in the preceding state, px.
        detected_px: ``(n, 2)`` new centroids, px.
        proximity_px: Largest distance of a match, px; ``inf`` for no limit.

    Returns:
        ``int64[m]`` indices into ``detected_px``, no index twice.

    Example:
        >>> import numpy as np
        >>> previous = np.array([[10.0, 10.0], [20.0, 10.0]])
        >>> associate(previous, np.array([[19.0, 10.0]]), 12.0).tolist()
        [-1, 0]
    """
    from scipy.spatial import KDTree  # a tenth of a second that only this function needs

    match = np.full(len(previous_px), UNMATCHED, np.int64)
    if not len(previous_px) or not len(detected_px):
        return match
    distance, nearest = KDTree(detected_px).query(previous_px)
    _, claimed = KDTree(previous_px).query(detected_px)
    own = np.asarray(claimed)[np.asarray(nearest)] == np.arange(len(previous_px))
    matched = own & (distance <= proximity_px)
    match[matched] = np.asarray(nearest)[matched]
    return match


@njit(cache=True)
def _root_kernel(parent: NDArray[np.int32], label: int) -> int:  # pragma: no cover - compiled
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@njit(cache=True)
def _label_kernel(
    state_map: NDArray[np.float32],
    threshold: float,
    labels: NDArray[np.int32],
    parent: NDArray[np.int32],
) -> int:  # pragma: no cover - compiled
    """Label bright pixels, 0 is ground, and note which labels belong together; return how many.

    The smallest label of a blob is its root, which keeps blobs in the order of their first pixel.
    """
    count = 0
    for y in range(state_map.shape[0]):
        above, row = labels[y], labels[y + 1]
        for x in range(state_map.shape[1]):
            label = 0
            if state_map[y, x] >= threshold:
                for other in (row[x], above[x], above[x + 1], above[x + 2]):
                    if other > 0:
                        root = _root_kernel(parent, other)
                        if label > 0:
                            parent[max(label, root)] = min(label, root)
                            root = min(label, root)
                        label = root
                if label == 0:
                    count += 1
                    label = parent[count] = count
            row[x + 1] = label
    return count


@njit(cache=True)
def _sum_kernel(
    state_map: NDArray[np.float32],
    labels: NDArray[np.int32],
    parent: NDArray[np.int32],
    number: NDArray[np.int32],
    sums: NDArray[np.float64],
) -> int:  # pragma: no cover - compiled
    """Add up the pixels of each blob; return how many blobs there are."""
    height, width = state_map.shape
    blobs = 0
    for label in range(1, parent.size):
        root = _root_kernel(parent, label)
        if root == label:
            number[label] = blobs
            sums[blobs] = 0.0
            blobs += 1
        number[label] = number[root]
    for y in range(height):
        for x in range(width):
            if labels[y + 1, x + 1] > 0:
                total, level = sums[number[labels[y + 1, x + 1]]], state_map[y, x]
                total[AREA] += 1.0
                total[MASS] += level
                total[MOMENT_X] += level * x
                total[MOMENT_Y] += level * y
                total[AT_BORDER] += y == 0 or x == 0 or y == height - 1 or x == width - 1
    return blobs
