"""One Gauss-Newton step of all discs: what the levels left over say about places and shapes.

Where a pixel's level stood when the recording began is not known, so that only its changes from
state to state count: each pixel's mean over the states around is taken off the levels and off their
derivatives. (Without the latter, a shift that is common to all states hardly shows: a disc that
never leaves some of its pixels stays where it was first seen, a pixel or more away.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import Discs
from spikingtac.markers.calibration.ideal_pixels import Comparison, Paths, compare
from spikingtac.markers.calibration.recording import BufferedEvents

# Added to the curvature of a place at one state, and of what all states of a disc share: shift
# along x and y, radius, edge (1 / px^2), so that what the events hardly tell stays where it is. A
# marker that moves has 1,000 and more.
PLACE_PRIOR, SHARED_PRIOR = 1.0, (30.0, 30.0, 100.0, 300.0)

# The same for a stretch, but that draws it to none, since wide edges hardly tell it from a motion
# (1 / px^2; not drawn, rests of a sensor like the recorded one err by half as much again).
STRETCH_PRIOR = 200.0

# Residuals beyond this level count less (Cauchy weights).
RESIDUAL_LEVEL = 0.35

# Variance of a level apart from its step's: shape and thresholds are never exact. (0.055 of a
# swing: the rms of the levels that the model leaves over on simulated recordings.)
LEVEL_VARIANCE = 0.003

# Pixels tell of a disc up to so many edge widths, and this margin, outside of its rim.
OUTSIDE_EDGES, MARGIN_PX = 3.5, 1.0

# A pixel's offset is a mean over so many states around (exponential weights), in which a state at
# which the pixel lies on a rim, where the offset cannot be told from the place, weighs this much.
# Real pixels lose a fifth of a swing over a rest of seconds. (Of 2 to 100 states, 2 to 10 are
# equally good on simulated and recorded presses.)
OFFSET_STATES, RIM_WEIGHT = 4.0, 0.1

# Between these levels a pixel lies on a rim.
RIM_LEVELS = (0.03, 0.97)


@dataclass(frozen=True, slots=True)
class Model:
    """All that explains the events.

    Attributes:
        paths: Where the markers went.
        discs: How they look.
        on: ``(m,)`` share of a full swing of each marker's ON event.
        off: The same for OFF events.
        pixel: ``(2, pixels)`` steps of a pixel's ON and OFF events, as shares of its marker's.
        residual: ``(m,)`` rms of the levels left over around each marker.
        events: ``(m, 4)`` events near each marker: real ON and OFF, expected ON and OFF.
        swings: ``(m,)`` full swings that were seen of each marker, both ways together.
        recovery_s: Time in which pixels forget light that they lost without an event, s; 0: never.
    """

    paths: Paths
    discs: Discs
    on: NDArray[np.float64]
    off: NDArray[np.float64]
    pixel: NDArray[np.float64]
    residual: NDArray[np.float64]
    events: NDArray[np.float64]
    swings: NDArray[np.float64]
    recovery_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a model has to explain.

    Attributes:
        events: The recording, markers brighter than the ground.
        states: ``(k,)`` samples at which real and ideal pixels are compared.
        still: ``(rests, 3)`` first, typical and last sample of each rest: nothing moves in it.
        cell: ``(pixels,)`` nearest marker of each pixel.
        noise: ``(2,)`` ON and OFF events that are expected near a marker without any motion.
    """

    events: BufferedEvents
    states: NDArray[np.int64]
    still: NDArray[np.int64]
    cell: NDArray[np.int64]
    noise: NDArray[np.float64]

    def seen(self, model: Model) -> Comparison:
        """Compare real pixels with ideal ones along a model's paths."""
        on, off = (
            (step[self.cell] * share).astype(np.float32)
            for step, share in zip((model.on, model.off), model.pixel, strict=True)
        )
        about = self.states, model.discs, (on, off), model.recovery_s
        return compare(self.events, model.paths, *about)

    def at_rest(self, model: Model) -> Model:
        """Return a model whose markers stand still in each rest."""
        center_px = model.paths.center_px.copy()
        for first, typical, last in self.still:
            center_px[first : last + 1] = center_px[typical]
        return replace(model, paths=replace(model.paths, center_px=center_px))


class Changes:
    """Levels less each pixel's mean over the states around.

    Attributes:
        on_rim: ``(states, pixels)`` where a pixel lies on a rim.
        real: ``(states, pixels)`` changes of the real pixels.
        ideal: Those of the ideal ones.
    """

    def __init__(
        self, seen: Comparison, states: float = OFFSET_STATES, rim_weight: float = RIM_WEIGHT
    ) -> None:
        apart = np.abs(np.subtract.outer(*[np.arange(len(seen.drawn))] * 2))
        self.on_rim = (seen.drawn > RIM_LEVELS[0]) & (seen.drawn < RIM_LEVELS[1])
        self._near = np.exp(-apart / states).astype(np.float32)
        self._weight = np.where(self.on_rim, np.float32(rim_weight), np.float32(1.0))
        self._total = self._near @ self._weight
        self.real, self.ideal = self.of(seen.measured), self.of(seen.expected)

    def of(self, levels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the changes of some levels ``(states, pixels)``, or of derivatives of them."""
        return np.asarray(levels - self._near @ (self._weight * levels) / self._total, np.float32)

    def swings(self, cell: NDArray[np.int64], markers: int) -> NDArray[np.float64]:
        """Return ``(m, 2)`` sums over the full swings of each marker's pixels from state to state.

        They are the real changes in units of the ideal ones, and the squares of these.
        """
        weight = self.ideal / (1.0 + ((self.real - self.ideal) / RESIDUAL_LEVEL) ** 2)
        weight[self.on_rim] = 0.0
        sums = [(weight * one).sum(axis=0) for one in (self.real, self.ideal)]
        return np.array([np.bincount(cell, one, markers) for one in sums], float).T


@dataclass(frozen=True, slots=True)
class Rims:
    """The pixels around each disc at each state, ``n`` in all.

    Attributes:
        at: Their states and pixels, two ``(n,)`` arrays.
        marker: ``(n,)`` their discs.
        slopes: ``(6, n)`` rise of the level per px of the disc's x, y, radius, edge and stretch.
    """

    at: tuple[NDArray[np.int64], NDArray[np.int64]]
    marker: NDArray[np.int64]
    slopes: NDArray[np.float64]

    def squares(
        self, levels: NDArray[np.float32], variance: NDArray[np.float64], markers: int
    ) -> NDArray[np.float64]:
        """Return ``(2, m)`` weighted squares of levels around each disc, and the weights."""
        level = levels[self.at].astype(np.float64)
        weight = robust_weight(level, variance[self.at[1]])
        sums = weight * level**2, weight
        return np.array([np.bincount(self.marker, one, markers) for one in sums], float)


def rims(evidence: Evidence, model: Model, seen: Comparison) -> Rims:
    """Return the pixels around each disc, nearer to its rim than to another one's."""
    state, pixel = np.nonzero(seen.owner >= 0)
    marker = seen.owner[state, pixel].astype(np.int64)
    y, x = np.divmod(pixel, evidence.events.size[0])
    center_px, stretch_px = (
        path[evidence.states][state, marker]
        for path in (model.paths.center_px, model.paths.stretch_px)
    )
    dx, dy = x - center_px[:, 0], y - center_px[:, 1]
    rho, edge_px = np.hypot(dx, dy), model.discs.edge_px[marker]
    across = np.maximum(rho, 0.5)
    ways = dx / across, dy / across, (dx**2 - dy**2) / across**2, 2.0 * dx * dy / across**2
    rim_px = model.discs.radius_px[marker] + stretch_px[:, 0]
    rim_px += stretch_px[:, 1] * ways[2] + stretch_px[:, 2] * ways[3]
    z = (rho - rim_px) / edge_px
    near = (z <= OUTSIDE_EDGES + MARGIN_PX / edge_px) & (rho >= 0.5)
    state, pixel, marker, z = state[near], pixel[near], marker[near], z[near]
    fall = model.discs.falls(marker, z)
    along_x, along_y, wide, slant = (fall * way[near] for way in ways)
    return Rims((state, pixel), marker, np.array([along_x, along_y, fall, fall * z, wide, slant]))


def level_variance(evidence: Evidence, model: Model) -> NDArray[np.float64]:
    """Return ``(pixels,)`` variances of the levels: even ones within a step, and the model's."""
    return (LEVEL_VARIANCE + (model.on**2 + model.off**2) / 12.0)[evidence.cell]


def robust_weight(error: NDArray[np.float64], variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Cauchy weights."""
    return 1.0 / (variance * (1.0 + (error / RESIDUAL_LEVEL) ** 2))


def corrections(
    evidence: Evidence, model: Model, seen: Comparison, change: Changes
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solve for one Gauss-Newton step of all discs.

    Discs stretch with the skin, by 0.2 px on the twin: an edge that is common to all states would
    take that for blur. So each state has its own growth of the radius and its own ellipse.

    Returns:
        ``(m, 4)`` shift of all places of a disc along x and y, and growth of its radius and of its
        edge, px; ``(states, m, 5)`` how far each place and stretch is off at each state beside
        that, px; ``(m,)`` rms of the levels left over.
    """
    around = rims(evidence, model, seen)
    markers, states, dense = len(model.on), len(evidence.states), np.zeros_like(seen.drawn)
    shared = np.empty_like(around.slopes[:4])
    for row, slope in zip(shared, around.slopes, strict=False):
        dense[around.at] = slope
        row[:] = change.of(dense)[around.at]
    variance = level_variance(evidence, model)
    left_over = change.real - change.ideal
    squares, weights = around.squares(left_over, variance, markers)
    error = left_over[around.at].astype(np.float64)
    weight = robust_weight(error, variance[around.at[1]])
    none = np.zeros((markers, 4))
    common_px = _solved(around.marker, (shared, error, weight), SHARED_PRIOR, none)
    error = error - (common_px[around.marker].T * shared).sum(axis=0)
    stretch_px = model.paths.stretch_px[evidence.states].reshape(-1, 3)
    drawn_px = np.hstack([np.zeros((len(stretch_px), 2)), -stretch_px])
    own = around.slopes[[0, 1, 2, 4, 5]], error, weight
    prior = (PLACE_PRIOR, PLACE_PRIOR, *[STRETCH_PRIOR] * 3)
    own_px = _solved(around.at[0] * markers + around.marker, own, prior, drawn_px)
    own_px = own_px.reshape(states, markers, 5)
    own_px[..., 2] -= own_px[..., 2].mean(axis=0)  # what all states grow by is the radius'
    return common_px, own_px, np.sqrt(squares / np.maximum(weights, 1e-9))


def _solved(
    group: NDArray[np.int64],
    rows: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    prior: tuple[float, ...],
    towards: NDArray[np.float64],
) -> NDArray[np.float64]:
    # Weighted least squares of each group of pixels: slopes (k, n), errors, weights. Without any
    # pixel the answer is ``towards``.
    (slopes, error, weight), groups = rows, len(towards)
    curvature, pull = np.tile(np.diag(prior), (groups, 1, 1)), towards * prior
    for i, one in enumerate(slopes):
        pull[:, i] += np.bincount(group, weight * one * error, groups)
        for j, other in enumerate(slopes):
            curvature[:, i, j] += np.bincount(group, weight * one * other, groups)
    return np.asarray(np.linalg.solve(curvature, pull[..., np.newaxis])[..., 0], np.float64)
