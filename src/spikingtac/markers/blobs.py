"""Blobs of a state map, to a fraction of a pixel, and which of them is which marker.

The paper extracts marker centroids "using a Blob Detection algorithm" (section IV-B) and says no
more. Here they are the 8-connected regions from one threshold on.

Then a k-d tree is queried to match new centroids with identities from the preceding state within a
proximity threshold (section IV-B). The paper does not say what happens when two markers claim one
centroid. Here a pair is matched only where each is the other's nearest, so that no centroid ever
serves two markers.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import FloatArray

UNMATCHED = -1  # What a marker without a centroid gets.

# Level half-way between ground and marker: it keeps a blurred disc's area, and on a binary map any
# level in (0, 1] is the same.
HALF_LEVEL = 0.5

# Smallest area, px: an eighth of the paper's marker (radius 7 px, area 154); noise at 1 Hz/px
# hardly ever makes 20 connected pixels behind a median filter. Largest area, px: two touching
# markers of radius 15 px still pass, a lit half of the sensor does not.
SMALLEST_PX, LARGEST_PX = 20.0, 2_000.0

# Areas of a blob that may be a marker, as shares of the smallest and the largest disc. (A
# smaller piece of a disc need not contain its centre; at a sudden release such pieces of the
# erased footprint lie nearer than the marker and would capture its identity. Motion stretches a
# marker in the map; two merged markers pass as well: the nearer one takes their joint centroid.)
SMALLEST_SHARE, LARGEST_SHARE = 0.5, 2.5

EIGHT_CONNECTED = np.ones((3, 3))  # Neighbours of a pixel.


@dataclass(frozen=True, slots=True)
class Blobs:
    """The blobs of one map, in order of their first pixel (row by row).

    Attributes:
        center_px: ``(n, 2)`` centroids (x, y), weighted with the map's values, px.
        area_px: ``(n,)`` number of pixels at or above the threshold.
        cut: ``(n,)`` True where the blob touches the border: its centroid is biased inwards.
        roundness: ``(n,)`` area over second moment, relative to a disc: 1, of all else less.
    """

    center_px: FloatArray
    area_px: FloatArray
    cut: NDArray[np.bool_]
    roundness: FloatArray


def find_blobs(
    state_map: NDArray[np.float32],
    threshold: float = HALF_LEVEL,
    areas_px: tuple[float, float] = (SMALLEST_PX, LARGEST_PX),
) -> Blobs:
    """Return the blobs of a map.

    Touching markers come out as one blob of their joint area: the caller, who knows the size of a
    marker, sees it in ``area_px``.

    Args:
        state_map: ``(height, width)`` float32.
        threshold: Level from which a pixel belongs to a blob.
        areas_px: Smallest and largest area of a blob, pixels.

    Example:
        >>> import numpy as np
        >>> state_map = np.zeros((20, 20), np.float32)
        >>> state_map[5:10, 8:13] = 1.0
        >>> find_blobs(state_map).center_px.tolist()
        [[10.0, 7.0]]
    """
    from scipy import ndimage  # a tenth of a second that only this function needs

    # Single precision, as the map: 0.2 in double precision lies above 0.2 in the map.
    found: Any = ndimage.label(state_map >= np.float32(threshold), EIGHT_CONNECTED)
    labels, count = found
    y, x = np.nonzero(labels)
    height, width = labels.shape
    at_border = (x == 0) | (y == 0) | (x == width - 1) | (y == height - 1)
    blob, level = labels[y, x] - 1, state_map[y, x].astype(np.float64)
    weights = (None, at_border, level, level * x, level * y, level * (x * x + y * y))
    sums = np.array([np.bincount(blob, of, count) for of in weights], np.float64)
    area_px, cut, mass, *moments, square = sums[
        :, (sums[0] >= areas_px[0]) & (sums[0] <= areas_px[1])
    ]
    center_px = (np.array(moments) / mass).T
    # Each pixel is a square, whose own second moment is 1 / 6.
    spread_px2 = square / mass - (center_px**2).sum(axis=1) + 1.0 / 6.0
    return Blobs(center_px, area_px, cut > 0.0, area_px / (2.0 * np.pi * spread_px2))


def blob_areas_px(radius_px: FloatArray) -> tuple[float, float]:
    """Return the smallest and the largest area of a blob that may be one of the markers, px."""
    disc_px = np.pi * radius_px**2
    return SMALLEST_SHARE * float(disc_px.min()), LARGEST_SHARE * float(disc_px.max())


def associate(
    previous_px: FloatArray, detected_px: FloatArray, proximity_px: float
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
