"""A pixel under a moving edge: how far the edge has gone when the pixel reports a level.

First-order low-pass in log intensity whose corner grows with the light (Hu, Liu, Delbruck 2021,
doi:10.1109/CVPRW53098.2021.00144), in one dimension:

    dv/dt = (L(q) - v) / tau,    tau = tau_white (1 + B) / (I + B),    I = contrast^(L - 1)

with L the log intensity from 0 (ground) to 1 (marker), I the light relative to white and B the dark
current (or veiling light) in the same unit. In a slow passage each level is late by its own tau; a
fast one smears the events. Everything depends on kappa = speed * tau_white only, in px.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_GRID_PX = 0.01  # Resolution of the profile: a fiftieth of an edge's width.

# How far behind the edge a pixel is followed, in its slowest lengths: e^-12 is left then.
_TRAIL = 12.0

# But at most this far (just under half a marker pitch, where the next edge comes).
_TRAIL_MAX_PX = 16.0
_MARGIN_WIDTHS = 12.0  # Logistic scales from an edge at which the light is even to 1e-5.


@dataclass(frozen=True, kw_only=True, slots=True)
class EdgeProfile:
    """The light across an edge.

    Attributes:
        contrast: Brighter over darker intensity; its inverse is accepted.
        edge_px: Logistic scale of the edge's intensity, px.
    """

    contrast: float
    edge_px: float

    @property
    def ratio(self) -> float:
        """Brighter over darker intensity, at least 1."""
        return max(self.contrast, 1.0 / self.contrast)

    def level(self, q_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ln(1 + (c - 1) / (1 + exp(q / s))) / ln c: 1 in the light, 0 in the dark."""
        share = 1.0 / (1.0 + np.exp(np.clip(q_px / self.edge_px, -60.0, 60.0)))
        return np.log1p((self.ratio - 1.0) * share) / np.log(self.ratio)

    def place_px(self, level: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return q where the level is met; the inverse of :meth:`level` inside (0, 1)."""
        share = np.expm1(np.clip(level, 1e-6, 1.0 - 1e-6) * np.log(self.ratio))
        return self.edge_px * np.log((self.ratio - 1.0) / share - 1.0)

    def slowness(self, level: NDArray[np.float64], dark: float) -> NDArray[np.float64]:
        """Return tau over tau_white at a level, (1 + B) / (I + B)."""
        return (1.0 + dark) / (self.ratio ** (level - 1.0) + dark)


def overshoot_px(
    edge: EdgeProfile,
    brightening: bool,
    levels: NDArray[np.float64],
    kappa_px: NDArray[np.float64],
    dark: float,
) -> NDArray[np.float64]:
    """Return how far past a level's place an edge is when the pixel reports that level.

    Args:
        edge: Light across the edge.
        brightening: True for an edge that brings light.
        levels: ``(k,)`` levels inside (0, 1).
        kappa_px: ``(n,)`` speed times tau_white, px, positive.
        dark: B, relative to white.

    Returns:
        ``(n, k)`` px along the motion, positive; ``kappa * slowness(level)`` for small kappa.
    """
    margin_px = _MARGIN_WIDTHS * edge.edge_px
    slow = float(edge.slowness(np.zeros(1), dark)[0])
    trail_px = min(_TRAIL_MAX_PX, _TRAIL * slow * float(kappa_px.max()))
    along = np.arange(-margin_px, margin_px + trail_px, _GRID_PX)
    side = -1.0 if brightening else 1.0
    seen = _low_passed(edge.level(side * along), edge, kappa_px, dark)
    rising = seen if brightening else 1.0 - seen
    asked = levels if brightening else 1.0 - levels
    # Strictly increasing for the inverse lookup, where float rounding left a plateau.
    rising = np.maximum.accumulate(rising, axis=0) + np.arange(len(along))[:, None] * 1e-12
    reached = np.stack([np.interp(asked, column, along) for column in rising.T])
    return reached - side * edge.place_px(levels)


def _low_passed(
    level: NDArray[np.float64], edge: EdgeProfile, kappa_px: NDArray[np.float64], dark: float
) -> NDArray[np.float64]:
    """Return ``(places, n)`` what pixels make of a level that changes along the motion.

    Exact for a level that changes evenly from place to place.
    """
    seen = np.empty((len(level), len(kappa_px)))
    seen[0] = level[0]
    slowness = edge.slowness(0.5 * (level[1:] + level[:-1]), dark)
    for i in range(1, len(level)):
        length_px = kappa_px * slowness[i - 1]
        behind = length_px * (level[i] - level[i - 1]) / _GRID_PX
        rest = seen[i - 1] - level[i - 1] + behind
        seen[i] = level[i] - behind + rest * np.exp(-_GRID_PX / length_px)
    return seen
