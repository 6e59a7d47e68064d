"""One Gauss-Newton step of all discs: corrections of positions and shapes from the residuals.

The level of a pixel at the start of the recording is unknown, so only its changes between states
are used: each pixel's mean over the neighbouring states is subtracted from the levels and from
their derivatives. (Without the latter, a shift common to all states is hardly observable: a disc
that never leaves some of its pixels stays where it was detected first, a pixel or more away.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.disc_profile import fall
from spikingtac.markers.calibration.find_markers import Evidence
from spikingtac.markers.calibration.ideal_pixels import Comparison, Model
from spikingtac.types import FloatArray

# Prior precision of a position at one state, and of the parameters that all states of a disc share:
# shift along x and y, radius, edge (1 / px^2). Priors of shifts are 0, of radii and edges the
# sensor's medians. The data of a marker that moves have 1,000 and more.
PLACE_PRIOR, SHARED_PRIOR = 1.0, (30.0, 30.0, 300.0, 900.0)

# Prior precision of a stretch, whose prior is 0 (1 / px^2): with wide edges it is hardly
# distinguishable from a motion (without the prior, rests of a sensor like the recorded one err by
# half as much again).
STRETCH_PRIOR = 200.0

# Residual of half weight (Cauchy).
RESIDUAL_LEVEL = 0.35

# Variance of a level beyond the quantisation by steps, since shapes and thresholds are not exact.
# (0.055 of a swing: the rms residual of the model on simulated recordings.)
LEVEL_VARIANCE = 0.003

# Number of states over which a pixel's offset is averaged (exponential weights), and the weight of
# a state at which the pixel lies on a rim, where offset and position are indistinguishable. Real
# pixels lose a fifth of a swing over a rest of seconds. (Of 2 to 100 states, 2 to 10 are equally
# good on simulated and recorded presses. With a weight of 1 pressed markers of the recorded gel err
# by 1.32 px instead of 0.72.)
OFFSET_STATES, RIM_WEIGHT = 4.0, 0.1

# Range of levels of a pixel on a rim; at a lower level it shows no disc.
RIM_LEVELS = (0.03, 0.97)


class Changes:
    """Levels ``(states, p)`` minus each pixel's mean over the neighbouring states."""

    def __init__(
        self,
        drawn: NDArray[np.float32],
        states: float = OFFSET_STATES,
        rim_weight: float = RIM_WEIGHT,
    ) -> None:
        apart = np.abs(np.subtract.outer(*[np.arange(len(drawn))] * 2))
        on_rim = (drawn > RIM_LEVELS[0]) & (drawn < RIM_LEVELS[1])
        self._near = np.exp(-apart / states).astype(np.float32)
        self._weight = np.where(on_rim, np.float32(rim_weight), np.float32(1.0))
        self._total = self._near @ self._weight

    def of(self, levels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the changes of levels, or of their derivatives."""
        return np.asarray(levels - self._near @ (self._weight * levels) / self._total, np.float32)


@dataclass(frozen=True, slots=True)
class Rims:
    """The pixels that show a disc at each state, ``n`` in all.

    Attributes:
        at: ``(n,)`` their indices in flattened ``(states, p)``.
        state: ``(n,)`` their states.
        marker: ``(n,)`` their discs.
        variance: ``(n,)`` variance of their levels: uniform within a step, and the model's.
        slopes: ``(6, n)`` derivatives of the level by x, y, radius, edge and stretch of the disc.
    """

    at: NDArray[np.int64]
    state: NDArray[np.int64]
    marker: NDArray[np.int32]
    variance: NDArray[np.float32]
    slopes: NDArray[Any]

    def weighted(self, levels: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return ``(n,)`` levels ``(states, p)`` of these pixels, and their Cauchy weights."""
        level = levels.ravel()[self.at]
        return level, 1.0 / (self.variance * (1.0 + (level / RESIDUAL_LEVEL) ** 2))

    def squares(self, levels: NDArray[np.float32], markers: int) -> FloatArray:
        """Return ``(m,)`` sums of weighted squares of levels around each disc."""
        level, weight = self.weighted(levels)
        return np.bincount(self.marker, weight * level**2, markers).astype(np.float64)


def rims(evidence: Evidence, model: Model, seen: Comparison) -> Rims:
    """Return the pixels that show a disc; where discs overlap, the brightest one."""
    at = np.flatnonzero(seen.drawn > RIM_LEVELS[0])
    state, column = np.divmod(at, len(seen.pixel))
    pixel = seen.pixel[column]
    marker = seen.owner.ravel()[at]
    y, x = np.divmod(pixel, evidence.events.size[0])
    center_px, stretch_px = (
        path[evidence.states].astype(np.float32)[state, marker]
        for path in (model.center_px, model.stretch_px)
    )
    dx, dy = x.astype(np.float32) - center_px[:, 0], y.astype(np.float32) - center_px[:, 1]
    rho = np.hypot(dx, dy)
    across = np.maximum(rho, np.float32(0.1))
    dx, dy = dx / across, dy / across
    wide, slant = dx * dx - dy * dy, 2.0 * dx * dy
    looks = model.discs.radius_px, model.discs.edge_px, model.discs.contrast
    radius_px, edge_px, contrast = np.array(looks, np.float32)[:, marker]
    rim_px = radius_px + stretch_px[:, 0] + stretch_px[:, 1] * wide + stretch_px[:, 2] * slant
    z = (rho - rim_px) / edge_px
    slopes = fall(z, contrast, edge_px) * np.stack([dx, dy, np.ones_like(z), z, wide, slant])
    variance = (LEVEL_VARIANCE + (model.steps**2).sum(axis=0) / 12.0).astype(np.float32)
    return Rims(at, state, marker, variance[evidence.cell[pixel]], slopes)


def corrections(
    evidence: Evidence, model: Model, seen: Comparison
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve for one Gauss-Newton step of all discs.

    Discs stretch with the skin, by 0.2 px on the twin, which would bias a common edge.
    So each state has its own growth of the radius and its own ellipse.

    Returns:
        ``(m, 4)`` common shift of a disc along x and y, and change of its radius and edge, px;
        ``(states, m, 5)`` further corrections of position and stretch at each state, px; ``(m,)``
        rms residual.
    """
    around, change = rims(evidence, model, seen), Changes(seen.drawn)
    markers, states, dense = len(model.residual), len(evidence.states), np.zeros_like(seen.drawn)
    shared = np.empty_like(around.slopes[:4])
    for row in range(4):
        dense.ravel()[around.at] = around.slopes[row]
        shared[row] = change.of(dense).ravel()[around.at]
    error, weight = around.weighted(change.of(seen.measured - seen.expected))
    total = np.maximum(np.bincount(around.marker, weight, markers), 1e-9)
    residual = np.sqrt(np.bincount(around.marker, weight * error**2, markers) / total)
    shapes_px = np.column_stack([model.discs.radius_px, model.discs.edge_px])
    towards_px = np.hstack([np.zeros((markers, 2)), np.median(shapes_px, axis=0) - shapes_px])
    common_px = _solved(around.marker, (shared, error, weight), SHARED_PRIOR, towards_px)
    error = error - (common_px.T.astype(np.float32)[:, around.marker] * shared).sum(axis=0)
    stretch_px = model.stretch_px[evidence.states].reshape(-1, 3)
    drawn_px = np.hstack([np.zeros((len(stretch_px), 2)), -stretch_px])
    own = around.slopes[[0, 1, 2, 4, 5]], error, weight
    prior = (PLACE_PRIOR, PLACE_PRIOR, *[STRETCH_PRIOR] * 3)
    own_px = _solved(around.state * markers + around.marker, own, prior, drawn_px)
    own_px = own_px.reshape(states, markers, 5)
    own_px[..., 2] -= own_px[..., 2].mean(axis=0)  # the mean growth belongs to the radius
    return common_px, own_px, residual


def _solved(
    group: NDArray[np.integer],
    rows: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    prior: tuple[float, ...],
    towards: FloatArray,
) -> FloatArray:
    # Regularised weighted least squares of each group of pixels: slopes (k, n), errors, weights.
    # ``towards`` is the prior mean.
    (slopes, error, weight), group = rows, group.astype(np.intp)
    curvature = np.tile(np.diag(prior), (len(towards), 1, 1))
    pull = towards * prior
    for row, slope in enumerate(slopes):
        weighted = weight * slope
        pull[:, row] += np.bincount(group, weighted * error, len(towards))
        for column, other in enumerate(slopes):
            curvature[:, row, column] += np.bincount(group, weighted * other, len(towards))
    return np.asarray(np.linalg.solve(curvature, pull[..., np.newaxis])[..., 0], np.float64)
