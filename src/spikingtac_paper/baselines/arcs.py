"""Arcs: clusters of active pixels of one polarity, and the pairs of arcs of one marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


@dataclass(frozen=True, slots=True)
class Arc:
    """A cluster of active pixels of one polarity.

    Attributes:
        label: Number in the label image.
        center_px: ``(2,)`` mean place of its pixels, px.
        flow_px_us: ``(2,)`` mean normal flow, px/us.
    """

    label: int
    center_px: NDArray[np.float64]
    flow_px_us: NDArray[np.float64]


def find_arcs(
    active: NDArray[np.bool_], flow: NDArray[np.float64], dilate_px: int, min_cluster_px: int
) -> tuple[NDArray[np.int32], list[Arc]]:
    """Cluster the active pixels that have a flow.

    Args:
        active: ``(height, width)`` active pixels of one polarity.
        flow: ``(2, height, width)`` normal flow, px/us; 0 where there is none.
        dilate_px: Pixels at most this far apart belong to one cluster, px.
        min_cluster_px: Smaller clusters are dropped, px.

    Returns:
        ``(height, width)`` label image (0 is none), and the arcs.
    """
    moving = active & ((flow[0] != 0.0) | (flow[1] != 0.0))
    grown = _dilated(moving, dilate_px // 2)
    label = np.zeros(grown.shape, np.int32)
    ndimage.label(grown, np.ones((3, 3)), output=label)
    count = int(label.max())
    label = np.where(active, label, 0).astype(np.int32)
    row, column = np.divmod(np.flatnonzero(moving), moving.shape[1])
    number = label[row, column]
    size = np.bincount(number, minlength=count + 1)
    safe = np.maximum(size, 1)
    # Of each arc: the mean of places and of flows.
    values = (column, row, flow[0, row, column], flow[1, row, column])
    x, y, u, v = (np.bincount(number, value, count + 1) / safe for value in values)
    kept = np.flatnonzero(size >= min_cluster_px)
    arcs = [Arc(int(k), np.array([x[k], y[k]]), np.array([u[k], v[k]])) for k in kept if k > 0]
    return label, arcs


def pair_arcs(
    trailing: list[Arc], leading: list[Arc], angle_deg: float, reach_px: float
) -> list[tuple[Arc, Arc]]:
    """Return pairs of arcs with the same motion, one behind the other.

    Each arc belongs to one pair at most.

    Args:
        trailing: Arcs that become darker: behind a bright marker.
        leading: Arcs that become brighter: in front of it.
        angle_deg: Largest angle between the two flows, and between them and the line from arc to
            arc, degrees.
        reach_px: Largest distance between the two arcs, px.
    """
    if not trailing or not leading:
        return []
    offset = _stack(leading, "center_px")[None] - _stack(trailing, "center_px")[:, None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    behind, before = _unit(_stack(trailing, "flow_px_us")), _unit(_stack(leading, "flow_px_us"))
    min_cosine = np.cos(np.radians(angle_deg))
    agree = behind @ before.T >= min_cosine
    direction = _unit(behind[:, None] + before[None])
    along = (direction * offset).sum(axis=2) >= min_cosine * distance
    cost = np.where(agree & along & (distance <= reach_px), distance, np.inf)
    pairs = []
    while np.isfinite(cost).any():
        i, j = np.unravel_index(int(cost.argmin()), cost.shape)
        pairs.append((trailing[int(i)], leading[int(j)]))
        cost[i], cost[:, j] = np.inf, np.inf
    return pairs


def _dilated(image: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    # Row by row, then column by column: ten times as fast as a general filter on booleans.
    grown = image.copy()
    for shift in range(1, reach_px + 1):
        grown[shift:] |= image[:-shift]
        grown[:-shift] |= image[shift:]
    wide = grown.copy()
    for shift in range(1, reach_px + 1):
        wide[:, shift:] |= grown[:, :-shift]
        wide[:, :-shift] |= grown[:, shift:]
    return wide


def _stack(arcs: list[Arc], name: str) -> NDArray[np.float64]:
    return np.array([getattr(arc, name) for arc in arcs])


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, np.finfo(np.float64).tiny)
