"""What the disc fit reads of the map: the pixels around an edge, and the edge's profile.

The pixels are sorted by their distance from the central one, so that those of any annulus lie
beside each other, and one window serves markers of every size. The profile S of
:mod:`spikingtac.calibration.disc_profile` and its slope become polynomials over the stretch where
the edge is steep: a compiler can vectorise them where it cannot vectorise a table or an
exponential.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.markers.edge_equations import LARGEST_SUM
from spikingtac.state_map.graded import PAD_PX

COEFFICIENT_DECIMALS = 6
"""Decimals of a coefficient: linear algebra differs between processors in the thirteenth or so, and
what is rounded off is the same everywhere (ours: single precision has seven digits)."""
POLYNOMIAL_DEGREE = 11
"""S within 0.001 and dS/dq within 2 % of its largest value, for every contrast and edge whose flat
ends :data:`FLAT_SHARE` cuts off."""

FLAT_SHARE = 0.02
"""Where the edge is less steep than this share of its steepest, a pixel says nothing of the centre:
the fit does not read it (at 0.05 the pixels are a tenth fewer and the tracks move by 0.004 px)."""

RING_PX = 0.5
"""Steps of distance in which pixels are counted."""

CURVE_POINTS = 2001
"""Points at which the polynomials are fitted: so many that more change nothing."""


@dataclass(frozen=True, slots=True)
class FitWindow:
    """The pixels that a fit may read, nearest first, as offsets from the central one.

    Attributes:
        offset: ``int64[n]`` offsets into the flat padded map.
        place_px: ``float32[2, n]`` columns and rows relative to the central pixel, px.
        within: ``int64[k]`` how many pixels are nearer than 0, 1, 2, ... RING_PX.
        coefficients: ``(m, 2, POLYNOMIAL_DEGREE + 1)`` float32 polynomials of each marker's S and
            -dS/dq over -1 (at the inner end) to 1.
        inner_px: ``(m,)`` where each edge begins, px outside of the radius (negative).
        outer_px: ``(m,)`` where it ends, px outside of the radius.
        unit: ``float32[m]`` whole steps in which a weight of one is counted, so that the sums of
            all its pixels fit into 32 bits.
    """

    offset: NDArray[np.int64]
    place_px: NDArray[np.float32]
    within: NDArray[np.int64]
    coefficients: NDArray[np.float32]
    inner_px: NDArray[np.float64]
    outer_px: NDArray[np.float64]
    unit: NDArray[np.float32]

    @property
    def pixels(self) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
        """Offsets, places and counts, as the fit takes them."""
        return self.offset, self.place_px, self.within

    def curves(self, iterations: int) -> tuple[Any, ...]:
        """Return the profiles as the fit takes them, with the number of its steps at most."""
        return self.coefficients, self.inner_px, self.outer_px, self.unit, iterations


def fit_window(profiles: list[DiscProfile], width_px: int, reach_px: float) -> FitWindow:
    """Choose the pixels and the polynomials.

    Args:
        profiles: The profile of each disc.
        width_px: Width of the sensor, px.
        reach_px: Farthest from the radius that a fit reads, px.
    """
    row_px = width_px + 2 * PAD_PX
    farthest_px = PAD_PX - 1
    span = np.arange(-farthest_px, farthest_px + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(span, span, indexing="ij"))
    distance = np.hypot(dx, dy)
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= farthest_px]
    dx, dy, distance = dx[order], dy[order], distance[order]
    stretches_px = [_steep_stretch_px(profile, reach_px) for profile in profiles]
    inner_px, outer_px = (np.array(ends) for ends in zip(*stretches_px, strict=True))
    coefficients = _polynomials(profiles, inner_px, outer_px)
    return FitWindow(
        offset=(dy * row_px + dx).astype(np.int64),
        place_px=np.stack([dx, dy]).astype(np.float32),
        within=np.searchsorted(distance, np.arange(0.0, farthest_px + RING_PX, RING_PX)),
        coefficients=coefficients,
        inner_px=inner_px,
        outer_px=outer_px,
        unit=_units(coefficients, len(order)),
    )


def _units(coefficients: NDArray[np.float32], pixels: int) -> NDArray[np.float32]:
    """Return ``(m,)`` steps that a weight of one is counted in.

    They are powers of two, which no rounding of a processor's own moves.
    """
    z = np.linspace(-1.0, 1.0, CURVE_POINTS)
    slope = np.zeros((len(coefficients), CURVE_POINTS))
    for factor in coefficients[:, 1, ::-1].T:
        slope = slope * z + factor[:, None]
    steepest = np.maximum(np.abs(slope).max(axis=1), 1.0)
    most = LARGEST_SUM / (pixels * steepest**2)
    return np.exp2(np.floor(np.log2(most))).astype(np.float32)


def _steep_stretch_px(profile: DiscProfile, reach_px: float) -> tuple[float, float]:
    q_px = np.linspace(-reach_px, reach_px, CURVE_POINTS)
    steepness = -profile.slope(q_px)
    steep_px = q_px[steepness > FLAT_SHARE * steepness.max()]
    return float(steep_px[0]), float(steep_px[-1])


def _polynomials(
    profiles: list[DiscProfile], inner_px: NDArray[np.float64], outer_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return ``(m, 2, POLYNOMIAL_DEGREE + 1)`` coefficients of every disc's curves.

    All are fitted at once: one by one they would take 6 ms each, 6 s for a skin of 1,024 markers.
    """
    unit = np.linspace(-1.0, 1.0, CURVE_POINTS)
    q_px = inner_px[:, None] + (outer_px - inner_px)[:, None] * (unit + 1.0) / 2.0
    curves = np.array(
        [
            (profile.level(places_px), -profile.slope(places_px))
            for profile, places_px in zip(profiles, q_px, strict=True)
        ]
    ).reshape(-1, CURVE_POINTS)
    series = chebyshev.chebfit(unit, curves.T, POLYNOMIAL_DEGREE)
    fitted = np.round(_powers(np.asarray(series, np.float64)), COEFFICIENT_DECIMALS)
    # Row after row: what reads them is vectorised only where they lie beside each other.
    return fitted.T.reshape(len(profiles), 2, -1).astype(np.float32, order="C")


def _powers(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the powers' coefficients of Chebyshev series, ``(degree + 1, curves)`` each.

    Clenshaw's recurrence, as :func:`numpy.polynomial.chebyshev.cheb2poly` takes it for one series.
    """
    low, high = np.zeros_like(series), np.zeros_like(series)
    low[0], high[0] = series[-2], series[-1]
    for below in series[-3::-1]:
        low, high = -high, low + 2.0 * _raised(high)
        low[0] += below
    return low + _raised(high)


def _raised(powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return polynomials times their variable; the highest power is none, and is left out."""
    return np.concatenate([np.zeros_like(powers[:1]), powers[:-1]])
