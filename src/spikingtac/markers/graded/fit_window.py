"""What the disc fit reads of the map: the pixels around an edge, and the edge's profile.

The profile S of :mod:`spikingtac.calibration.disc_profile` and its slope are polynomials over the
stretch where the edge is steep: a compiler can vectorise them where it cannot vectorise a table or
an exponential. The pixels are sorted by their distance from the central one, so that those of any
annulus lie beside each other, and one window serves markers of every size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.state_map.graded import PAD_PX

# Largest magnitude of a sum of the normal equations, in steps: it fits into 32 bits.
LARGEST_SUM = 2.0**30

# Decimals of a coefficient: linear algebra differs between processors in the thirteenth or so,
# and what is rounded off is the same everywhere (single precision has seven digits).
COEFFICIENT_DECIMALS = 6

# S within 0.001 and dS/dq within 2 % of its largest value, for every contrast and edge whose flat
# ends :data:`FLAT_SHARE` cuts off.
POLYNOMIAL_DEGREE = 11

# Where the edge is less steep than this share of its steepest, a pixel says nothing of the
# centre: the fit does not read it (at 0.05 the pixels are a tenth fewer and the tracks move by
# 0.004 px).
FLAT_SHARE = 0.02

REACH_PX = 6.0  # Farthest from the radius that a fit reads, px.

CURVE_POINTS = 2001  # Points at which the polynomials are fitted: so many that more change nothing.

RING_PX = 0.5  # Steps of distance in which pixels are counted.


class FitWindow(NamedTuple):
    """The pixels that a fit may read, nearest first, and the edges that it looks for.

    Attributes:
        offset: ``int64[n]`` offsets into the flat padded map, from the central pixel.
        place_px: ``float32[2, n]`` columns and rows relative to the central pixel, px.
        within: ``int64[k]`` how many pixels are nearer than 0, 1, 2, ... RING_PX.
        coefficients: ``(m, 2, POLYNOMIAL_DEGREE + 1)`` float32 polynomials of each marker's S and
            -dS/dq over -1 (at the inner end) to 1.
        edge: ``float32[m, 3]`` where each edge begins and ends, px outside of the radius; whole
            steps in which a weight of one is counted.
    """

    offset: NDArray[np.int64]
    place_px: NDArray[np.float32]
    within: NDArray[np.int64]
    coefficients: NDArray[np.float32]
    edge: NDArray[np.float32]


def fit_window(profiles: list[DiscProfile], width_px: int) -> FitWindow:
    """Choose the pixels and the polynomials for discs on a sensor of a width, px."""
    farthest_px = PAD_PX - 1
    span = np.arange(-farthest_px, farthest_px + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(span, span, indexing="ij"))
    distance = np.hypot(dx, dy)
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= farthest_px]
    dx, dy, distance = dx[order], dy[order], distance[order]
    ends_px = np.array([_steep_stretch_px(profile) for profile in profiles])
    coefficients = _polynomials(profiles, ends_px)
    edge = np.column_stack([ends_px, _units(coefficients, len(order))])
    return FitWindow(
        offset=(dy * (width_px + 2 * PAD_PX) + dx).astype(np.int64),
        place_px=np.stack([dx, dy]).astype(np.float32),
        within=np.searchsorted(distance, np.arange(0.0, farthest_px + RING_PX, RING_PX)),
        coefficients=coefficients,
        edge=edge.astype(np.float32),
    )


def _steep_stretch_px(profile: DiscProfile) -> tuple[float, float]:
    q_px = np.linspace(-REACH_PX, REACH_PX, CURVE_POINTS)
    steepness = -profile.slope(q_px)
    steep_px = q_px[steepness > FLAT_SHARE * steepness.max()]
    return float(steep_px[0]), float(steep_px[-1])


def _polynomials(profiles: list[DiscProfile], ends_px: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return ``(m, 2, POLYNOMIAL_DEGREE + 1)`` coefficients of every disc's curves.

    All are fitted at once: one by one they would take 6 ms each, 6 s for a skin of 1,024 markers.
    """
    z = np.linspace(-1.0, 1.0, CURVE_POINTS)
    q_px = ends_px[:, :1] + np.diff(ends_px) * (z + 1.0) / 2.0
    curves = [(p.level(q), -p.slope(q)) for p, q in zip(profiles, q_px, strict=True)]
    series = np.polynomial.polynomial.polyfit(
        z, np.array(curves).reshape(-1, CURVE_POINTS).T, POLYNOMIAL_DEGREE
    )
    # Row after row: what reads them is vectorised only where they lie beside each other.
    rows = np.round(series, COEFFICIENT_DECIMALS).T.reshape(len(profiles), 2, -1)
    return rows.astype(np.float32, order="C")


def _units(coefficients: NDArray[np.float32], pixels: int) -> NDArray[np.float64]:
    """Return ``(m,)`` steps that a weight of one is counted in: powers of two are never rounded."""
    z = np.linspace(-1.0, 1.0, CURVE_POINTS)
    slope = np.polynomial.polynomial.polyval(z, coefficients[:, 1].T.astype(np.float64))
    steepest = np.maximum(np.abs(slope).max(axis=1), 1.0)
    return np.exp2(np.floor(np.log2(LARGEST_SUM / (pixels * steepest**2))))
