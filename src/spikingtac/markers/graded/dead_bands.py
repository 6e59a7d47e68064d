"""Fit of a disc to the dead bands of the pixels, for large steps and wide edges.

Between two events a pixel's level lies in its dead band: between its thresholds around the level of
its last event. Where a threshold is a third of the swing, the middle of the band is wrong by as
much, and a fit to it is held back. So a pixel's full residual M - S(|x - c| - R(phi)) is used only
once, in the fit after its event, when its level was exact. A pixel without an event contributes the
distance by which the disc would leave its band, if it does. Both correct the predicted centre by a
few robust Gauss-Newton steps. Then levels that disagree are corrected towards the fitted disc, so
that errors of the pixels' thresholds do not add up. One state for pose and brightness is the idea
of event-based mosaicing (Kim et al. 2014, doi:10.5244/C.28.26).

An event of noise tells nothing of a level. While no more events come than noise brings, the latest
ones count as noise by that share: they weigh less, and their steps are taken back. (With noise of
0.1 to 1 Hz/px simulated presses err by 40 % more without this, since each such event moves its disc
by 0.1 px.)

The map shows a pixel's own level after its event, and after the fit the disc's level clipped to the
pixel's band. So a pixel whose shown level equals its own has fired since the last fit.
"""

from typing import Any

import numpy as np

from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import FitWindow
from spikingtac.markers.graded.disc_fit import (
    SOFT_LEVEL,
    Ring,
    edge_bounds_kernel,
    sample_ring_kernel,
    step_kernel,
    update_outline_kernel,
)
from spikingtac.state_map.graded import OUTSIDE_LEVEL, PAD_PX, Array

# Weight of the prediction relative to a pixel that fired, on an edge that rises by a full swing per
# px (0.15 to 0.3 are alike within 7 % on simulated press sensors).
PRIOR_WEIGHT = 0.2

# Weight of a pixel that did not fire relative to one that did (0.4 to 0.6: within 3 %).
BAND_WEIGHT = 0.5

SOFT_RESIDUAL = 0.4  # Residual of half weight (Cauchy; 0.8 errs by up to 4 % more).

GAIN = 0.5  # Share of a level's disagreement that one fit corrects (0.4 and 0.5: within 3 %).

# Prior weight of an outline, as a sum of squared slopes: a few new pixels do not determine a shape
# (2 to 5: within 3 %; without any, markers are lost).
OUTLINE_PRIOR = 4.0

SMALL_STEP_PX = 0.005  # A fit whose last step was shorter has converged.

# Time over which a marker's events are compared with the noise, s (0.005 to 0.02: within 3 %).
RECENT_S = 0.01


@kernel(forceinline=True)
def signal_share_kernel(
    marker: Any, events: int, noise_per_s: float, t_us: int
) -> float:  # pragma: no cover - compiled
    """Return the share of a marker's latest events that come from motion, and count new events.

    One standard deviation of the noise counts as noise, too.
    """
    marker.recent = marker.recent * np.exp(1e-6 * (marker.fit_us - t_us) / RECENT_S) + events
    noise = noise_per_s * RECENT_S
    return max(1.0 - (noise + np.sqrt(noise)) / max(marker.recent, 0.5), 0.0)


@kernel(forceinline=True)
def _residual_kernel(
    pixel: Any, shown: float, disc: float, signal: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return the residual of a pixel's level against the disc's, and its weight.

    It is the full difference where the pixel has just fired, and otherwise the part beyond the dead
    band: without an event a level may lie above the disc's by an OFF step, and below by an ON step.
    """
    e, weight = pixel.level - disc, signal
    if shown != pixel.level:
        e, weight = max(e + pixel.off, 0.0) + min(e + pixel.on, 0.0), BAND_WEIGHT
    return e, (e != 0.0) * weight / (1.0 + e * e / SOFT_RESIDUAL**2)


@kernel()
def _center_equations_kernel(
    pixels: Array, window: FitWindow, ring: Ring, at: tuple[Any, Any], edge: Array,
    signal: float,
) -> tuple[tuple[float, float, float], tuple[float, float]]:  # pragma: no cover # fmt: skip
    """Return the curvature (xx, xy, yy) and the gradient (x, y) of a disc's pixels."""
    phase, first, inside, _ = ring
    xx = xy = yy = gx = gy = 0.0
    for j in range(inside):
        if edge[0, j] == OUTSIDE_LEVEL:
            continue
        row = at[0] + window.offset[phase, 1, first + j]
        pixel = pixels[np.uint64(row), np.uint64(at[1] + window.offset[phase, 2, first + j])]
        e, weight = _residual_kernel(pixel, edge[0, j], edge[1, j], signal)
        jx = edge[2, j] * window.polar[phase, 1, first + j]
        jy = edge[2, j] * window.polar[phase, 2, first + j]
        xx, xy, yy = xx + weight * jx * jx, xy + weight * jx * jy, yy + weight * jy * jy
        gx, gy = gx + weight * jx * e, gy + weight * jy * e
    return (xx, xy, yy), (gx, gy)


@kernel()
def _correct_levels_kernel(
    maps: tuple[Array, Array], window: FitWindow, ring: Ring, at: tuple[Any, Any], edge: Array,
    signal: float,
) -> tuple[tuple[float, float, float], float, float]:  # pragma: no cover - compiled # fmt: skip
    """Correct levels towards the fitted disc, and show the disc's levels clipped to the bands.

    Returns the gradients of r, b and c, the curvature of r, and the share of the edge that agrees.
    """
    (pixels, flat), (phase, first, inside, _) = maps, ring
    gr = gb = gc = rr = agreeing = total = 0.0
    for j in range(inside):
        if edge[0, j] == OUTSIDE_LEVEL:
            continue
        row = at[0] + window.offset[phase, 1, first + j]
        column = at[1] + window.offset[phase, 2, first + j]
        pixel, level, slope = pixels[np.uint64(row), np.uint64(column)], edge[1, j], edge[2, j]
        apart = (pixel.level - level) / SOFT_LEVEL
        agreeing, total = agreeing + slope / (1.0 + apart * apart), total + slope
        e, weight = _residual_kernel(pixel, edge[0, j], level, signal)
        pull = weight * slope * e
        gr += pull
        gb += pull * window.polar[phase, 3, first + j]
        gc += pull * window.polar[phase, 4, first + j]
        rr += weight * slope * slope
        change = GAIN * e / (1.0 + e * e / SOFT_RESIDUAL**2)
        if edge[0, j] == pixel.level:  # take the step of a noise event back
            change = signal * change + (1.0 - signal) * min(max(e, pixel.off), pixel.on)
        pixel.level -= np.float32(change)
        bound = min(max(level, pixel.level + pixel.off), pixel.level + pixel.on)
        flat[(row + PAD_PX) * (pixels.shape[1] + 2 * PAD_PX) + column + PAD_PX] = bound
    return (gr, gb, gc), rr, agreeing / (total + 1e-6)


@kernel()
def fit_bands_kernel(
    pixels: Array, levels: tuple[Array, int, int], edge: Array, window: FitWindow, m: int,
    center_px: tuple[float, float], outline_px: Array, settings: tuple[int, float, float],
    signal: float,
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled # fmt: skip
    """Fit a marker's centre, correct the levels, and update its outline.

    Args:
        pixels: ``(height, width)`` of PIXEL: levels of the last events, which change, and steps.
        levels: As for :func:`~spikingtac.markers.graded.disc_fit.fit_disc_kernel`, and so are
            ``edge``, ``window`` and ``settings``; the map is changed.
        edge: Scratch.
        window: Pixels and profiles.
        m: Number of the marker.
        center_px: The predicted position, px.
        outline_px: ``(m, 3)`` r, b and c of the discs, px; changed.
        settings: Most Gauss-Newton steps; gain of the outline's step; radius at rest, px.
        signal: Share of the latest events that come from motion.

    Returns:
        x, y, the share of the edge that agrees, and the length of the last step.
    """
    (x, y), length, ends_px = center_px, 0.0, edge_bounds_kernel(window, m, outline_px)
    for _ in range(settings[0]):
        ring, at = sample_ring_kernel(levels, window, m, (x, y), ends_px, outline_px, edge)
        (xx, xy, yy), (gx, gy) = _center_equations_kernel(pixels, window, ring, at, edge, signal)
        gx, gy = gx + PRIOR_WEIGHT * (center_px[0] - x), gy + PRIOR_WEIGHT * (center_px[1] - y)
        step_x, step_y, length = step_kernel((xx + PRIOR_WEIGHT, xy, yy + PRIOR_WEIGHT), (gx, gy))
        x, y = x + step_x, y + step_y
        if length < SMALL_STEP_PX:
            break
    ring, at = sample_ring_kernel(levels, window, m, (x, y), ends_px, outline_px, edge)
    gradient, rr, agreement = _correct_levels_kernel(
        (pixels, levels[0]), window, ring, at, edge, signal
    )
    update_outline_kernel(outline_px, m, gradient, settings[1] / (rr + OUTLINE_PRIOR), settings[2])
    return x, y, agreement, length
