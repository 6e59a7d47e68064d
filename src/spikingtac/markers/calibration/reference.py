"""Where markers rest without load, from where they stood whenever nothing touched them.

The paper takes the middle of the box around all equilibrium states (section IV-D, the equation of
P_init); ``bounding-box`` is that. The default ``rest-mean`` is ours: creep after a contact leaves
each rest a little off, to the side from which it came. Contacts of many kinds cancel in the mean,
where a box keeps the two outermost rests of each axis alone. What they have in common does not
cancel, since presses spread the skin, and only time takes it back. So the rest before the first
contact, and others that are long enough, are held against the mean of the short ones: the more the
two differ, the less the short ones count.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Method = Literal["rest-mean", "bounding-box"]

SETTLED_US = 3_000_000
"""After so long a rest the skin has crept back (recorded presses)."""

STARTS_US = 200_000
"""A rest that begins so soon after the recording does counts as settled: hardly anybody starts to
record within seconds after a contact."""

NEAR_PX = 0.15
"""A rest so far from the weighted median counts half (Cauchy weights): the residual of creep."""

SINGLE_REST_PX = 0.17
"""Error that is assumed of the place at a single rest (simulated sensors: 0.06 to 0.22 px at the
first rest; for the twin, v2e and a transparent model, 0.15 to 0.2 is best or as good as any)."""


def reference(
    position_px: NDArray[np.float64], rests_us: NDArray[np.int64], method: Method
) -> NDArray[np.float64]:
    """Return ``(m, 2)`` reference positions, px.

    Args:
        position_px: ``(rests, m, 2)`` positions at the unloaded rests, px.
        rests_us: ``(rests, 2)`` when each began and ended, us since the start of the recording.
        method: How they are reduced to one.
    """
    if method == "bounding-box":
        return (position_px.min(axis=0) + position_px.max(axis=0)) / 2.0
    length_us = np.diff(rests_us, axis=1)[:, 0]
    settled = (rests_us[:, 0] < STARTS_US) | (length_us >= SETTLED_US)
    if settled.all() or not settled.any():
        return _typical(position_px, length_us)
    early, late = (_typical(position_px[some], length_us[some]) for some in (settled, ~settled))
    scatter = ((position_px[~settled] - late) ** 2).sum(axis=2).mean()
    variances = SINGLE_REST_PX**2 / settled.sum(), scatter / np.count_nonzero(~settled)
    creep = max(((late - early) ** 2).sum(axis=1).mean() - sum(variances), 0.0)
    share = variances[0] / (variances[0] + variances[1] + creep)
    return early + share * (late - early)


def _typical(position_px: NDArray[np.float64], length_us: NDArray[Any]) -> NDArray[np.float64]:
    # A mean in which long rests count more, and those far from the others less.
    weight = np.minimum(np.asarray(length_us, float), SETTLED_US)
    middle = weighted_median(position_px, weight)
    off = np.linalg.norm(position_px - middle, axis=2)
    share = weight[:, np.newaxis] / (1.0 + (off / NEAR_PX) ** 2)
    return (share[..., np.newaxis] * position_px).sum(axis=0) / share.sum(axis=0)[:, np.newaxis]


def weighted_median(values: NDArray[np.float64], weight: NDArray[Any]) -> NDArray[np.float64]:
    """Return the medians over the first axis, interpolated between the middles of the weights.

    Example:
        >>> float(weighted_median(np.array([1.0, 2.0, 9.0]), np.array([1, 1, 1])))
        2.0
    """
    order = np.argsort(values, axis=0, kind="stable")
    ordered = np.take_along_axis(values, order, axis=0)
    share = np.asarray(weight, float)[order] / float(np.sum(weight))
    middle = np.cumsum(share, axis=0) - 0.5 * share
    flat = zip(middle.reshape(len(values), -1).T, ordered.reshape(len(values), -1).T, strict=True)
    found = [np.interp(0.5, place, value) for place, value in flat]
    return np.array(found).reshape(values.shape[1:])


def mean_pitch_px(position_px: NDArray[np.float64], shape: tuple[int, int]) -> float:
    """Return the mean distance of neighbours in rows and columns, px; infinite for one marker."""
    cells = position_px.reshape(*shape, 2)
    steps = [np.diff(cells, axis=axis).reshape(-1, 2) for axis in (0, 1)]
    length = np.hypot(*np.concatenate(steps).T)
    return float(length.mean()) if len(length) else np.inf
