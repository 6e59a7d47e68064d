"""From fitted discs to given places: lag, backlash, and what the neighbours say.

Backlash: a fitted disc stays behind its marker, whichever way it moves.

A pixel fires when its level has changed by a step. The foot of a disc's edge, which has not risen
by one yet, is still ground on the map, and what has not fallen by one is still disc: the fit is
held back by a share of the way in which the edge crosses a step, at any speed. So it is no lag; it
is the play of a gear. After a marker turns round it is worse: each pixel must first cross its dead
band back, and those that have not yet hold the fit. Against truth (simulated, v2e) a fit is 0.04 px
behind in steady motion, 0.24 px half a px after a turn, and has caught up after 4 to 8 px; on a
flawed gel, whose steps and edges are larger, it is 0.1 and 0.23 px.

The given place is ahead of the fitted one by two play operators, a short one that tells the
direction of motion, and a long one that tells the fit's direction some px ago: a steady share of
the first, and a share of their difference, which is large after a turn and vanishes on the way. A
weighted sum of play operators (Krasnosel'skii and Pokrovskii 1989, doi:10.1007/978-3-642-61302-9)
is a Prandtl-Ishlinskii model, and this is its use as a compensator (Kuhnen 2003,
doi:10.3166/ejc.9.407-418). The shares and widths are ours.

Noise takes the hysteresis away: a pixel that sent one up and one down is in its band anew. So what
is ahead fades at the rate at which a pixel sends two events of noise.

A skin turns round as a whole, or nearly, and each fit notices it when its own pixels have crossed
their dead bands. So the direction is that of the neighbours together: some notice a turn sooner,
and eight jitter less than one.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.motion import AT_US, VX, VY, X, Y
from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.state_map.graded import Array

# Half of the way in which the direction of motion is told anew, in crossings (0.1 to 0.3
# are alike on the training scenes; below it is the fit's own jitter).
SHORT_PLAY = 0.2

# Half of the way in which a fit catches up after a turn, in crossings (3 to 6 are alike on
# the training scenes).
LONG_PLAY = 4.0

# By how much a fit stays behind its marker in steady motion, as a share of the way in which an
# edge crosses one step (at 0.15 five simulated scenes err by 0.7 to 3 % more, at 0.25 by 0 to 3 %).
STEADY_SHARE = 0.2

# By how much more it stays behind just after the marker turned round (chosen on the
# training scenes; both together shrink their errors by 5 %).
TURN_SHARE = 0.3

# Rate at which the hysteresis fades with a noise of 1 Hz/px, 1/s; it grows with the square. (At
# rest after motion the noisy twin errs by 0.137 px without, by 0.124 at 1; below 0.2 Hz/px all is
# alike.)
FADING_PER_S = 1.0

# Difference from the neighbours that is as likely an error of the fit as deformation, px.
SHRINK_PX = 0.2

LOADED_PX = 1.5  # Mean displacement from which there is a contact.

# Mean and largest displacement up to which the skin may have been released, each marker averaged
# with its neighbours: what pixels forget differs from marker to marker, a press does not. (The
# recorded sensor leaves up to 0.54 and 1.47 px behind, calibrated from half of its contacts; its
# presses are 2.4 px and more.)
NEAR_PX, NEAR_MOST_PX = 0.65, 1.6

STILL_PX_S = 3.0  # Mean speed below which the skin stands still: the jitter of a filtered velocity.

TINY_PX2 = 1e-12  # Square of a difference, px^2, that is none: two zeros are not divided.

# How long the skin stands still before the zero follows what is left; how long it follows; and
# the time constant of that.
WAIT_S, LEARN_S, SETTLE_S = 0.1, 2.0, 0.1


FADE_PX = 2.0  # Displacement of a marker at which a third of it is still taken off.


class OutputCorrections:
    """Where the markers are, given where their discs were found."""

    def __init__(self, calibration: Calibration, neighbours: Neighbourhood, shrink: float) -> None:
        """Begin at rest: nothing is known of the last motion.

        Args:
            calibration: Steps and edges of the markers.
            neighbours: What markers say of each other.
            shrink: Share of a fit's error by which differences from the neighbours shrink.
        """
        crossings = crossing_px(calibration)
        self._sensor = crossings, neighbours.own_share, *neighbours.skin
        self._states = np.zeros((4, len(crossings), 2))
        self._states[0] = neighbours.reference_px
        self._noise_px = shrink * SHRINK_PX

    def update(
        self, t_us: int, motion: Array, lag_s: float, backlash: float, noise: tuple[float, float]
    ) -> NDArray[np.float64]:
        """Return ``(m, 2)`` where the markers are, px.

        Args:
            t_us: The time, us.
            motion: ``(m, 8)`` states (:mod:`spikingtac.markers.graded.motion`).
            lag_s: Delay of the events, s.
            backlash: Share of the backlash that is made good.
            noise: Background, Hz/px, and the time since the last call, s.
        """
        given_px = np.empty((len(motion), 2))
        settings = float(t_us), lag_s, backlash, *noise, self._noise_px
        correct_kernel(motion, *self._sensor, self._states, *settings, given_px)
        return given_px


@kernel()
def correct_kernel(
    motions: Array, crossings: Array, own_share: Array, reference_px: Array, index: Array,
    weight: Array, states: Array, t_us: float, lag_s: float, backlash: float,
    background_hz_px: float, dt_s: float, noise_px: float, given_px: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Bring every marker up to the present, and correct it; see :class:`OutputCorrections`.

    Arguments are plain, since a tuple costs a microsecond: motions; of the markers the crossings,
    px, the part that each has in its difference from the others, rests, neighbours and their
    weights; ``(4, m, 2)`` places of the last call, px, states of the short and the long operator as
    shares of their widths, and scratch; the time, the delay of the events, the share of the
    backlash that is made good, the background, the time since the last call, and the difference
    that is as likely an error as deformation, px; the result.
    """
    last_px, direction, way, moved_px = states[0], states[1], states[2], states[3]
    kept, noise2 = np.exp(-FADING_PER_S * background_hz_px**2 * dt_s), noise_px**2 + TINY_PX2
    steady, turning = STEADY_SHARE * backlash, TURN_SHARE * backlash
    for m in range(crossings.size):
        since_s = (t_us - motions[m, AT_US]) * 1e-6
        now_x = motions[m, X] + since_s * motions[m, VX]
        now_y = motions[m, Y] + since_s * motions[m, VY]
        for play, state in ((SHORT_PLAY, direction), (LONG_PLAY, way)):
            per_px = 1.0 / (play * crossings[m])
            x = kept * state[m, 0] + (now_x - last_px[m, 0]) * per_px
            y = kept * state[m, 1] + (now_y - last_px[m, 1]) * per_px
            share = 1.0 / max(np.sqrt(x * x + y * y), 1.0)
            state[m, 0], state[m, 1] = share * x, share * y
        last_px[m, 0], last_px[m, 1] = now_x, now_y
    for m in range(crossings.size):
        told_x = told_y = 0.0
        for k in range(index.shape[1]):
            told_x += direction[index[m, k], 0]
            told_y += direction[index[m, k], 1]
        told = crossings[m] * (steady + turning) / index.shape[1]
        ahead_x = told * told_x - crossings[m] * turning * way[m, 0] + lag_s * motions[m, VX]
        ahead_y = told * told_y - crossings[m] * turning * way[m, 1] + lag_s * motions[m, VY]
        moved_px[m, 0] = last_px[m, 0] + ahead_x - reference_px[m, 0]
        moved_px[m, 1] = last_px[m, 1] + ahead_y - reference_px[m, 1]
    # A difference r from the neighbours' prediction shrinks by its share noise^2 / (r^2 + noise^2),
    # of which the marker takes the part that its own error has in it: 0.9 amid eight neighbours,
    # 0.6 in a corner. One far above the noise stays.
    for m in range(crossings.size):
        x, y = moved_px[m, 0], moved_px[m, 1]
        for k in range(index.shape[1]):
            x -= weight[m, k] * moved_px[index[m, k], 0]
            y -= weight[m, k] * moved_px[index[m, k], 1]
        taken = own_share[m] * noise2 / (x * x + y * y + noise2)
        given_px[m, 0] = reference_px[m, 0] + moved_px[m, 0] - taken * x
        given_px[m, 1] = reference_px[m, 1] + moved_px[m, 1] - taken * y


class ReleasedZero:
    """Learns what is left after each contact, and takes it off: for pixels that recover.

    Such pixels do not remember where their disc rested: each contact leaves fits beside their
    rests, half a pixel on the recorded sensor, at random from marker to marker. The gel does
    remember: after a release it stands still within 0.1 s. What is left then, near the rest, is
    taken off until the next contact has ended.

    It is learned only within a short time after a contact, and only if the markers, averaged with
    their neighbours, are near their rests: a static press is not taken for a rest, however long it
    lasts, nor is one that begins softly.
    """

    def __init__(self, neighbours: Neighbourhood) -> None:
        """Begin at rest, with nothing to take off."""
        self._reference_px = neighbours.reference_px
        own = np.arange(len(self._reference_px))[:, np.newaxis]
        self._around = np.hstack([own, neighbours.index])
        self._zero_px = np.zeros_like(self._reference_px)
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
            smooth_px = np.linalg.norm(left_px[self._around].mean(axis=1), axis=1)
            near = smooth_px.mean() < NEAR_PX and smooth_px.max() < NEAR_MOST_PX
            if near:
                share = -np.expm1(-dt_s / SETTLE_S)
                self._zero_px[seen] += share * (left_px - self._zero_px)[seen]
            self._loaded = self._still_s < LEARN_S
        left_px -= self._zero_px
        away2 = (left_px**2).sum(axis=1, keepdims=True)
        return detected_px - self._zero_px * np.exp(-away2 / FADE_PX**2)
