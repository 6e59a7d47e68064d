"""Reference positions of the markers without load, from their positions at all unloaded rests.

The paper takes the centre of the bounding box of all equilibrium states (section IV-D, the equation
of P_init): method ``bounding-box``. The default ``rest-mean`` is our own. A skin that was just
touched rests a little off towards the side to which it was pressed, since the gel creeps. The
creep is the same share of the displacement for all markers and contacts, so that all rests
determine it. After any contact the skin is also spread a little about its centroid, which only a
rest before all contacts can show. Both are subtracted, and the rest positions are averaged: one
rest alone may be off by a pixel where edges are wide.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import FloatArray

Method = Literal["rest-mean", "bounding-box"]

SETTLED_US = 3_000_000  # Duration of a rest after which the skin has crept back (recorded presses).

# Duration for which a rest counts once in the median: the shortest rest. (With equal weights a
# simulated gel with three rests errs by 0.20 px instead of 0.16.)
COUNTED_US = 100_000

# Distance from that median at which a rest has half weight (Cauchy): the residual of creep.
NEAR_PX = 0.15

# Largest plausible creep, as a share of the displacement (simulated gels have 0.01 to 0.03; five
# rests of the recorded one give 0.29 by chance).
MOST_CREEP = 0.15

# Largest plausible spread of the whole skin after contacts. (The twin's plate leaves 0.12 %. A
# negative spread is no creep: with wide edges the first rest appears too far outside, since earlier
# events are unknown.)
MOST_SPREAD = 0.03

TOUCHED_PX = 0.2  # Mean displacement before a rest from which it counts as a contact.

# Least rms variation of a cause between rests to be estimated, px.
TELLING_PX = 0.01

# Least evidence of creep: the share of the rests' variance that it explains, times the number of
# rests less one, at least 2. (Simulated gels that creep have 0.94 and more, presses with 2 % of
# creep 0.53; eleven sensors without creep 0 to 0.33. An independent one would have 1 by chance, but
# many markers show it.)
LEAST_EVIDENCE = 0.45


def reference(
    position_px: FloatArray, rests_us: NDArray[np.int64], displaced_px: FloatArray, method: Method
) -> FloatArray:
    """Return ``(m, 2)`` reference positions, px.

    Args:
        position_px: ``(rests, m, 2)`` positions at the unloaded rests, px.
        rests_us: ``(rests, 2)`` begin and end of each, us.
        displaced_px: ``(rests, m, 2)`` mean displacement in the contact before each rest, px; zero
            without a contact.
        method: How the rests are combined.
    """
    if method == "bounding-box":
        return (position_px.min(axis=0) + position_px.max(axis=0)) / 2.0
    length_us = np.diff(rests_us, axis=1)[:, 0]
    creep, spread = creep_shares(position_px, displaced_px)
    left_px = creep * displaced_px + spread * _from_centroid(position_px, displaced_px)
    return robust_mean(position_px - left_px, length_us)


def creep_shares(position_px: FloatArray, displaced_px: FloatArray) -> tuple[float, float]:
    """Return the creep, a share of the displacements before the rests, and the spread of the skin.

    They are non-negative least-squares slopes over all markers and rests, with equal weights: the
    last rest, often the longest, is known worst. The spread is 0 without a rest before the first
    contact, and the creep is 0 if all contacts are equal. Both are 0 where they explain little, or
    are implausible.
    """
    off_px, moved_px, spread_px = (
        values - values.mean(axis=0)
        for values in (position_px, displaced_px, _from_centroid(position_px, displaced_px))
    )
    causes = np.column_stack([moved_px.ravel(), spread_px.ravel()])
    causes *= (causes**2).mean(axis=0) > TELLING_PX**2
    from scipy.optimize import nnls  # 0.1 s that trackers need not wait

    shares, left_px = nnls(causes, off_px.ravel())
    little = left_px**2 > (1.0 - LEAST_EVIDENCE / max(len(off_px) - 1, 2)) * (off_px**2).sum()
    if little or shares[0] > MOST_CREEP:
        return 0.0, 0.0
    return float(shares[0]), min(float(shares[1]), MOST_SPREAD)


def _from_centroid(position_px: FloatArray, displaced_px: FloatArray) -> FloatArray:
    # (rests, m, 2) positions relative to the centroid of the skin, 0 before the first contact.
    moved_px = np.linalg.norm(displaced_px, axis=2).mean(axis=1)
    touched = np.maximum.accumulate(moved_px > TOUCHED_PX)
    place_px = np.median(position_px, axis=0)
    return touched[:, np.newaxis, np.newaxis] * (place_px - place_px.mean(axis=0))


def displaced_before(
    rests_us: NDArray[np.int64],
    position_px: FloatArray,
    sample_us: NDArray[np.int64],
    sample_px: FloatArray,
) -> FloatArray:
    """Return ``(rests, m, 2)`` mean displacement between each rest and the one before it, px.

    Args:
        rests_us: ``(rests, 2)`` begin and end of each, us.
        position_px: ``(rests, m, 2)`` positions at the rests, px.
        sample_us: ``(k,)`` times of the samples, us.
        sample_px: ``(k, m, 2)`` positions at the samples, px.
    """
    middle_px = np.median(position_px, axis=0)
    starts_us = np.concatenate([sample_us[:1], rests_us[:-1, 1]])
    first, last = np.searchsorted(sample_us, [starts_us, rests_us[:, 0]])
    return np.array([
        (sample_px[begin:end] - middle_px).mean(axis=0) if end > begin else 0.0 * middle_px
        for begin, end in zip(first, last, strict=True)
    ])  # fmt: skip


def robust_mean(position_px: FloatArray, length_us: NDArray[Any]) -> FloatArray:
    """Return ``(m, 2)`` robust means: long rests have more weight, outliers less."""
    weight = np.minimum(np.asarray(length_us, float), SETTLED_US)
    counts = np.ceil(weight / COUNTED_US).astype(int)
    middle_px = np.median(np.repeat(position_px, counts, axis=0), axis=0)
    off = np.linalg.norm(position_px - middle_px, axis=2)
    share = weight[:, np.newaxis] / (1.0 + (off / NEAR_PX) ** 2)
    return (share[..., np.newaxis] * position_px).sum(axis=0) / share.sum(axis=0)[:, np.newaxis]
