"""Which blob is which marker: mutual nearest neighbours within a threshold.

Section IV-B: a k-d tree is queried to match new centroids with identities from the preceding state
within a proximity threshold; a marker without a match keeps its last position (zero-order hold).
The paper does not say what happens when two markers claim one centroid. Here a pair is matched only
where each is the other's nearest, so that no centroid ever serves two markers.

Two implementations give the same answer: :func:`associate_tree` is the paper's, on
``scipy.spatial.KDTree``; :func:`associate` compares all pairs, which for 64 markers is several
times faster than building two trees.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNMATCHED = -1
"""What a marker without a centroid gets."""


def associate(
    previous_px: NDArray[np.float64], detected_px: NDArray[np.float64], proximity_px: float
) -> NDArray[np.int64]:
    """Return for each marker the centroid that is its own, or :data:`UNMATCHED`.

    Args:
        previous_px: ``(m, 2)`` markers in the preceding state, px.
        detected_px: ``(n, 2)`` new centroids, px.
        proximity_px: Largest distance of a match, px; ``inf`` for no limit.

    Returns:
        ``int64[m]`` indices into ``detected_px``, no index twice; of equally near candidates the
        lower index wins.

    Example:
        >>> import numpy as np
        >>> previous = np.array([[10.0, 10.0], [20.0, 10.0]])
        >>> associate(previous, np.array([[19.0, 10.0]]), 12.0).tolist()
        [-1, 0]
    """
    match = np.full(len(previous_px), UNMATCHED, np.int64)
    nearest = np.empty(len(previous_px), np.int64)
    _associate_kernel(previous_px, detected_px, proximity_px**2, nearest, match)
    return match


def associate_tree(
    previous_px: NDArray[np.float64], detected_px: NDArray[np.float64], proximity_px: float
) -> NDArray[np.int64]:
    """Do what :func:`associate` does with k-d trees, as the paper words it.

    Only the choice between exactly equal distances may differ.
    """
    from scipy.spatial import KDTree  # a tenth of a second that only this function needs

    match = np.full(len(previous_px), UNMATCHED, np.int64)
    if not len(previous_px) or not len(detected_px):
        return match
    distance, nearest = KDTree(detected_px).query(previous_px)
    _, claimed = KDTree(previous_px).query(detected_px)
    candidates = np.asarray(nearest)
    own = np.asarray(claimed)[candidates] == np.arange(len(previous_px))
    matched = own & (distance <= proximity_px)
    match[matched] = candidates[matched]
    return match


@njit(cache=True)
def _associate_kernel(
    previous: NDArray[np.float64],
    detected: NDArray[np.float64],
    limit: float,
    nearest: NDArray[np.int64],
    match: NDArray[np.int64],
) -> None:
    markers, centroids = len(previous), len(detected)
    shortest = np.full(markers, np.inf)
    for j in range(centroids):
        x, y = detected[j, 0], detected[j, 1]
        claimed, claim = UNMATCHED, np.inf
        for i in range(markers):
            distance = (previous[i, 0] - x) ** 2 + (previous[i, 1] - y) ** 2
            # Of 64 markers 63 are far off: one branch that a processor can foresee.
            if distance > limit:
                continue
            if distance < claim:
                claimed, claim = i, distance
            if distance < shortest[i]:
                shortest[i], nearest[i] = distance, j
                match[i] = UNMATCHED
        # The claim stands only while this centroid stays the marker's nearest.
        if claimed != UNMATCHED and nearest[claimed] == j:
            match[claimed] = j
