"""A skin that was released is where it rests: what is left then is no displacement.

Pixels that recover (:mod:`spikingtac.markers.calibration.recovery`) do not remember
where their disc rested: each contact leaves fits beside their rests, half a pixel on the recorded
sensor, at random from marker to marker. The gel does remember: after a release it sends no event
more, so that it stands still within 0.1 s. What is left once a contact has ended, and the skin
stands still near its rest, is therefore taken off from then on, until the next contact has ended.

It is learned only within a short time after a contact, and only if the markers, averaged with their
neighbours, are near their rests: a static press is not taken for a rest, however long it lasts, nor
is one that begins softly. A contact that is eased, but for less than these limits, is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.markers.neighbours import Neighbourhood

LOADED_PX = 1.5  # Mean displacement from which there is a contact.

# Mean and largest displacement up to which the skin may have been released, each marker averaged
# with its neighbours: what pixels forget differs from marker to marker, a press does not. (The
# recorded sensor leaves up to 0.54 and 1.47 px behind, calibrated from half of its contacts; its
# presses are 2.4 px and more.)
NEAR_PX, NEAR_MOST_PX = 0.65, 1.6

FARTHEST_PX = 3.5  # The same for a marker by itself (the recorded sensor up to 3.0 px).

STILL_PX_S = 3.0  # Mean speed below which the skin stands still: the jitter of a filtered velocity.

# How long the skin stands still before the zero follows what is left; how long it follows; and
# the time constant of that.
WAIT_S, LEARN_S, SETTLE_S = 0.1, 2.0, 0.1


FADE_PX = 2.0  # Displacement of a marker at which a third of it is still taken off.


class ReleasedZero:
    """Learns what is left after each contact, and takes it off."""

    def __init__(self, reference_px: NDArray[np.float64], neighbours: Neighbourhood) -> None:
        """Begin at rest, with nothing to take off.

        Args:
            reference_px: ``(m, 2)`` where the markers rest, px.
            neighbours: Of these markers.
        """
        self._reference_px = reference_px
        own = np.arange(len(reference_px))[:, np.newaxis]
        self._around = np.hstack([own, neighbours.index])
        self._zero_px = np.zeros_like(reference_px)
        self._loaded, self._still_s = False, 0.0

    def update(
        self,
        detected_px: NDArray[np.float64],
        velocity_px_s: NDArray[np.float64],
        held: NDArray[np.bool_],
        dt_s: float,
    ) -> NDArray[np.float64]:
        """Return ``(m, 2)`` places less what the last contact left behind, px.

        Args:
            detected_px: ``(m, 2)`` places as they were fitted, px.
            velocity_px_s: ``(m, 2)`` velocities, px/s.
            held: ``(m,)`` markers that are not seen; they tell nothing.
            dt_s: Time since the last call, s.
        """
        left_px = detected_px - self._reference_px
        seen = ~held
        count = np.count_nonzero(seen)
        if not count:
            return detected_px.copy()
        # Sums over a count: the method mean takes three times as long for so few numbers.
        away_px = np.hypot(left_px[:, 0], left_px[:, 1])[seen]
        mean_away_px = float(away_px.sum()) / count
        speed_px_s = float(np.hypot(velocity_px_s[:, 0], velocity_px_s[:, 1])[seen].sum()) / count
        self._still_s = self._still_s + dt_s if speed_px_s < STILL_PX_S else 0.0
        if mean_away_px > LOADED_PX:
            self._loaded = True
        elif self._loaded and self._still_s > WAIT_S:
            if away_px.max() < FARTHEST_PX and self._is_near(left_px):
                share = -np.expm1(-dt_s / SETTLE_S)
                self._zero_px[seen] += share * (left_px - self._zero_px)[seen]
            self._loaded = self._still_s < LEARN_S
        left_px -= self._zero_px
        away2 = (left_px**2).sum(axis=1, keepdims=True)
        return detected_px - self._zero_px * np.exp(-away2 / FADE_PX**2)

    def _is_near(self, left_px: NDArray[np.float64]) -> bool:
        smooth_px = np.linalg.norm(left_px[self._around].mean(axis=1), axis=1)
        return bool(smooth_px.mean() < NEAR_PX and smooth_px.max() < NEAR_MOST_PX)
