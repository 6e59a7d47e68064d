"""Where markers rest without load, from where they stood whenever nothing touched them.

The paper takes the middle of the box around all equilibrium states (section IV-D, the equation of
P_init); ``bounding-box`` is that. The default ``rest-mean`` is ours. After any contact the skin is
spread a little about its middle, which only a rest before all contacts can tell. That is taken off,
and what is left is averaged: a skin that was just touched rests a little off, and the place at one
rest alone may be wrong by a pixel where edges are wide.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Method = Literal["rest-mean", "bounding-box"]

SETTLED_US = 3_000_000  # After so long a rest the skin has crept back (recorded presses).

# A rest so far from the weighted median counts half (Cauchy weights): the residual of creep.
NEAR_PX = 0.15

# Largest share by which contacts are believed to leave the whole skin spread. (The twin's plate
# leaves 0.12 %, without which its rests are off by 0.12 instead of 0.04 px. Less than nothing is no
# creep: pixels with wide edges show the first rest too far outside, since what they saw before is
# not known.)
MOST_SPREAD = 0.03

TOUCHED_PX = 0.5  # Mean distance of the markers from their rests that only contacts reach.


def reference(
    position_px: NDArray[np.float64],
    length_us: NDArray[np.int64],
    touched: NDArray[np.bool_],
    method: Method,
) -> NDArray[np.float64]:
    """Return ``(m, 2)`` reference positions, px.

    Args:
        position_px: ``(rests, m, 2)`` positions at the unloaded rests, px.
        length_us: ``(rests,)`` how long each lasted, us: long ones count more.
        touched: ``(rests,)`` whether something has touched the skin before.
        method: How they are reduced to one.
    """
    if method == "bounding-box":
        return (position_px.min(axis=0) + position_px.max(axis=0)) / 2.0
    place_px = np.median(position_px, axis=0)
    away_px = touched[:, np.newaxis, np.newaxis] * (place_px - place_px.mean(axis=0))
    off_px, cause_px = (values - values.mean(axis=0) for values in (position_px, away_px))
    # The least-squares slope over all markers and rests.
    spread = float((off_px * cause_px).sum() / max((cause_px**2).sum(), 1e-9))
    position_px = position_px - min(max(spread, 0.0), MOST_SPREAD) * away_px
    weight = np.minimum(length_us.astype(np.float64), SETTLED_US)
    far_px = np.linalg.norm(position_px - weighted_median(position_px, weight), axis=2)
    share = weight[:, np.newaxis] / (1.0 + (far_px / NEAR_PX) ** 2)
    return (share[..., np.newaxis] * position_px).sum(axis=0) / share.sum(axis=0)[:, np.newaxis]


def touched_before(center_px: NDArray[np.float64], rests: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return ``(rests,)`` whether markers have moved before each rest.

    Args:
        center_px: ``(n, m, 2)`` places at all samples, px.
        rests: ``(rests,)`` samples of the rests, increasing.
    """
    away_px = np.linalg.norm(center_px - np.median(center_px[rests], axis=0), axis=2).mean(axis=1)
    return np.asarray(np.maximum.accumulate(away_px)[rests] > TOUCHED_PX)


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
