"""Corrections of the fitted positions: lag, hysteresis, outliers among neighbours, and zero offset.

Hysteresis (backlash): a fitted disc stays behind its marker, whichever way it moves. A pixel fires
when its level has changed by a step. The foot of a disc's edge, which has not risen by a step yet,
is still ground on the map, and what has not fallen by a step is still disc. So the fit is held back
by a share of the length over which the edge crosses a step, at any speed: this is no lag but the
play of a gear. After a reversal it is worse: each pixel must first cross its dead band back, and
pixels that have not yet done so hold the fit. Against truth (simulated, v2e) a fit is 0.04 px
behind in steady motion, 0.24 px half a px after a reversal, and has caught up after 4 to 8 px. On
a flawed gel, whose steps and edges are larger, it is 0.1 and 0.23 px.

The compensation is a weighted sum of two play operators, a Prandtl-Ishlinskii model
(Krasnosel'skii and Pokrovskii 1989, doi:10.1007/978-3-642-61302-9) that serves as a compensator
(Kuhnen 2003, doi:10.3166/ejc.9.407-418). A short play follows the direction of motion, a long one
the direction of the fit some px ago. The position leads the fit by a share of the short play, and
by a share of the difference of both, which is large after a reversal and then vanishes. The shares
and widths are our own.

Noise erases hysteresis: a pixel that sent an event up and one down is at rest in its band again. So
the plays decay at the rate at which a pixel sends two events of noise.

A skin reverses as a whole, or nearly, but each fit shows it only when its own pixels have crossed
their dead bands. So the direction is the mean over the neighbours: some of them notice a reversal
sooner, and eight jitter less than one.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.graded.appearance import crossing_px
from spikingtac.markers.graded.motion import AT_REST_PX_S
from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray

# Half-width of the short play, whose state is the direction of motion, in crossings: lengths over
# which an edge crosses one step (0.1 to 0.3 are alike on the training scenes; below it is the
# fit's own jitter).
SHORT_PLAY = 0.2

# Half-width of the long play: the motion after a reversal over which a fit catches up, in crossings
# (3 to 6 are alike on the training scenes).
LONG_PLAY = 4.0

# By how much a fit stays behind its marker in steady motion, in crossings (at 0.15 five simulated
# scenes err by 0.7 to 3 % more, at 0.25 by 0 to 3 %).
STEADY_SHARE = 0.2

# By how much more it stays behind just after a reversal, in crossings (chosen on the training
# scenes; both together shrink their errors by 5 %).
TURN_SHARE = 0.3

# Rate at which the hysteresis decays with a noise of 1 Hz/px, 1/s; it grows with the square of the
# noise. (At rest after motion the noisy twin errs by 0.137 px without, by 0.124 at 1. With 0.5 to
# 1 Hz/px v2e's recording and two other simulated sensors err by 1.5 to 5.6 % less at 4 than at 1,
# two scenes of the twin by 1.2 and 1.5 % more.)
FADING_PER_S = 4.0

# Residual against the neighbours that is as likely an error of the fit as deformation, px.
SHRINK_PX = 0.2

LOADED_PX = 1.5  # Mean displacement from which the skin is in contact.

# Largest mean and largest single displacement of a released skin, each marker averaged with its
# neighbours: what pixels forget differs from marker to marker, a press does not. (The recorded
# sensor leaves up to 0.54 and 1.47 px behind, calibrated from half of its contacts; its presses
# are 2.4 px and more.)
NEAR_PX, NEAR_MOST_PX = 0.65, 1.6

TINY_PX2 = 1e-12  # Keeps the shrinkage of a zero residual defined, px^2.

# Time for which the skin stands still before the zero offset is learned, the time after which
# learning ends, and its time constant.
WAIT_S, LEARN_S, SETTLE_S = 0.1, 2.0, 0.1

FADE_PX = 2.0  # Displacement of a marker at which 1/e of its zero offset is still subtracted.


class OutputCorrections:
    """Corrects fitted positions for lag and hysteresis, and shrinks residuals among neighbours."""

    def __init__(self, calibration: Calibration, neighbours: Neighbourhood, shrink: float) -> None:
        """Begin at rest, with both plays at zero.

        Args:
            calibration: Steps and edges of the markers.
            neighbours: Predicts each marker's displacement from its neighbours.
            shrink: Share of a fit's error by which residuals against the neighbours shrink.
        """
        crossings = crossing_px(calibration)
        self._sensor = crossings, neighbours.own_share, *neighbours.arrays
        self._states = np.zeros((4, len(crossings), 2))
        self._states[0] = neighbours.reference_px
        self._noise_px = shrink * SHRINK_PX

    def update(
        self, t_us: int, markers: Array, lag_s: float, backlash: float, noise: tuple[float, float]
    ) -> FloatArray:
        """Return ``(m, 2)`` corrected positions, px.

        Args:
            t_us: Time of the estimate, us.
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            lag_s: Delay of the events, s.
            backlash: Share of the backlash that is compensated.
            noise: Background, Hz/px, and the time since the last call, s.
        """
        given_px = np.empty((len(markers), 2))
        settings = t_us, lag_s, backlash, *noise, self._noise_px
        compensate_kernel(markers, *self._sensor, self._states, *settings, given_px)
        return given_px


@kernel()
def compensate_kernel(
    markers: Array, crossings: Array, own_share: Array, reference_px: Array, index: Array,
    weight: Array, states: Array, t_us: int, lag_s: float, backlash: float,
    background_hz_px: float, dt_s: float, noise_px: float, given_px: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Predict every marker to the present, and correct it; see :class:`OutputCorrections`.

    Arguments are plain, since a tuple costs a microsecond: records of the markers; their
    crossings, px, the share of a residual that is their own error, rest positions, neighbours and
    their weights; ``(4, m, 2)`` positions of the last call, px, states of the short and the long
    play relative to their half-widths, and scratch; the time, the delay of the events, the share of
    the backlash that is compensated, the background, the time since the last call, and the residual
    that is as likely an error as deformation, px; the result.
    """
    last_px, direction, long_play, moved_px = states[0], states[1], states[2], states[3]
    decay, noise2 = np.exp(-FADING_PER_S * background_hz_px**2 * dt_s), noise_px**2 + TINY_PX2
    steady, turning = STEADY_SHARE * backlash, TURN_SHARE * backlash
    for m in range(crossings.size):
        since_s = (t_us - markers[m].t_us) * 1e-6
        now_x = markers[m].x + since_s * markers[m].vx
        now_y = markers[m].y + since_s * markers[m].vy
        for width, state in ((SHORT_PLAY, direction), (LONG_PLAY, long_play)):
            per_px = 1.0 / (width * crossings[m])
            x = decay * state[m, 0] + (now_x - last_px[m, 0]) * per_px
            y = decay * state[m, 1] + (now_y - last_px[m, 1]) * per_px
            share = 1.0 / max(np.sqrt(x * x + y * y), 1.0)
            state[m, 0], state[m, 1] = share * x, share * y
        last_px[m, 0], last_px[m, 1] = now_x, now_y
    # The lead over the fit compensates the backlash and the motion during the lag.
    for m in range(crossings.size):
        sum_x = sum_y = 0.0
        for k in range(index.shape[1]):
            sum_x += direction[index[m, k], 0]
            sum_y += direction[index[m, k], 1]
        mean = crossings[m] * (steady + turning) / index.shape[1]
        lead_x = mean * sum_x - crossings[m] * turning * long_play[m, 0] + lag_s * markers[m].vx
        lead_y = mean * sum_y - crossings[m] * turning * long_play[m, 1] + lag_s * markers[m].vy
        moved_px[m, 0] = last_px[m, 0] + lead_x - reference_px[m, 0]
        moved_px[m, 1] = last_px[m, 1] + lead_y - reference_px[m, 1]
    # A residual r against the neighbours shrinks by noise^2 / (r^2 + noise^2) times the marker's
    # share of the error: 0.9 amid eight neighbours, 0.6 in a corner.
    for m in range(crossings.size):
        x, y = moved_px[m, 0], moved_px[m, 1]
        for k in range(index.shape[1]):
            x -= weight[m, k] * moved_px[index[m, k], 0]
            y -= weight[m, k] * moved_px[index[m, k], 1]
        shrunk = own_share[m] * noise2 / (x * x + y * y + noise2)
        given_px[m, 0] = reference_px[m, 0] + moved_px[m, 0] - shrunk * x
        given_px[m, 1] = reference_px[m, 1] + moved_px[m, 1] - shrunk * y


class ReleasedSkin:
    """Rest after each contact, on sensors whose events do not tell where it is.

    The gel returns to rest: it stands still within 0.1 s after a release. Recovering pixels do not
    remember where their disc rested: each contact leaves the fits beside their rest positions, half
    a pixel on the recorded sensor, at random from marker to marker. This zero offset is learned,
    and subtracted until the next contact has ended. Dead bands hide the last way back instead, and
    the creep after it, which is as long. There the filters are drawn to the rest positions, from
    which the next events move them.

    This is done only within a short time after a contact, and only if the markers, averaged with
    their neighbours, are near their rest positions. So neither a static press, however long, nor
    one that begins softly is taken for a rest.
    """

    def __init__(self, neighbours: Neighbourhood, recovers: bool) -> None:
        """Begin at rest, without an offset.

        Args:
            neighbours: Rest positions, and whom each marker is averaged with.
            recovers: Whether pixels recover; otherwise dead bands hide the rest.
        """
        self._reference_px, self._recovers = neighbours.reference_px, recovers
        own = np.arange(len(self._reference_px))[:, np.newaxis]
        self._around = np.hstack([own, neighbours.index])
        self._zero_px = np.zeros_like(self._reference_px)
        self._loaded, self._still_s = False, 0.0

    def update(
        self, detected_px: FloatArray, markers: Array, coasted: NDArray[np.bool_], dt_s: float
    ) -> FloatArray:
        """Return ``(m, 2)`` positions less their zero offset, px, or draw the filters to rest.

        Args:
            detected_px: ``(m, 2)`` fitted positions, px.
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            coasted: ``(m,)`` lost markers; they are left out.
            dt_s: Time since the last call, s.
        """
        left_px, seen = detected_px - self._reference_px, ~coasted
        if not seen.any():
            return detected_px.copy()
        share = self._settling_share(left_px, markers, seen, dt_s)
        if self._recovers:
            self._zero_px[seen] += share * (left_px - self._zero_px)[seen]
            left_px -= self._zero_px
            away2 = (left_px**2).sum(axis=1, keepdims=True)
            return detected_px - self._zero_px * np.exp(-away2 / FADE_PX**2)
        markers["x"][seen] -= share * left_px[seen, 0]
        markers["y"][seen] -= share * left_px[seen, 1]
        return detected_px

    def _settling_share(
        self, left_px: FloatArray, markers: Array, seen: NDArray[np.bool_], dt_s: float
    ) -> float:
        """Return the share of the way to rest that a released skin has gone since the last call."""
        count = np.count_nonzero(seen)
        # Sums over a count: the method mean takes three times as long for so few numbers.
        mean_away_px = float(np.hypot(left_px[:, 0], left_px[:, 1])[seen].sum()) / count
        speed_px_s = float(np.hypot(markers["vx"], markers["vy"])[seen].sum()) / count
        self._still_s = self._still_s + dt_s if speed_px_s < AT_REST_PX_S else 0.0
        if mean_away_px > LOADED_PX:
            self._loaded = True
        elif self._loaded and self._still_s > WAIT_S:
            self._loaded = self._still_s < LEARN_S
            smooth_px = np.linalg.norm(left_px[self._around].mean(axis=1), axis=1)
            if smooth_px.mean() < NEAR_PX and smooth_px.max() < NEAR_MOST_PX:
                return float(-np.expm1(-dt_s / SETTLE_S))
        return 0.0
