"""Track management: which markers are observed, which are held, and how they come back.

A marker is lost when its fit no longer agrees with the map, when its displacement leaves the range
of its neighbours' by more than :data:`spikingtac.markers.neighbours.FARTHEST_PITCHES`, or when it
sends no events while they move. It is then held: predicted from its neighbours, and looked for at a
low rate by a detection in the full map. A detection is taken only near the prediction, only if no
other marker owns it, so that identities cannot swap, and only if the marker is not silent.

A map painted from a calibration holds a disc for each marker, and where a marker came off no event
ever contradicts it. But the skin moves there, as the neighbours show, and a disc that moves sends
events. The travel that the neighbours tell of and no events confirm is summed up (a CUSUM test,
Page 1954, doi:10.1093/biomet/41.1-2.100). How far a marker should move is taken with care: the
speed that the neighbours' affine motion predicts (the centre of a rotation rests), and no more than
nearly all of them have (at the rim of a touch some rest). Markers at the border are not held for
silence: motion dies away towards it, and no neighbour stands beyond to vouch for it; but their
confidence falls.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.kernels import kernel
from spikingtac.markers.blobs import UNMATCHED, associate, blob_areas_px, find_blobs
from spikingtac.markers.graded.event_loss import (
    BACKGROUND_SHARE,
    FAST_PX_S,
    SLOW_PX_S,
    EventLoss,
)
from spikingtac.markers.graded.motion import AGREEMENT, FIT_US, FIT_X, NEVER_US, VX, VY
from spikingtac.markers.neighbours import Neighbourhood, around_kernel, smallest_spacing_px
from spikingtac.state_map.graded import Array

LEAST_AGREEMENT = 0.35  # Share of the edge that must agree with the fitted disc.

PATIENCE_US = 20_000  # How long a marker may look lost before it is held, us.

SEARCH_US = 20_000  # Time between two full-frame detections while a marker is held, us.

# Largest distance between prediction and detection, as a share of the smallest spacing.
CAPTURE_SHARE = 0.3

FADE_S = 0.1  # Time in which the confidence in a held marker falls by a factor e, s.

# Travel without events of its own after which a marker is silent, px. Its confidence falls on the
# way there (a reversal costs up to half a px).
SILENT_PX = 2.0

# Share of the events of its travel from which a marker counts as sending: half of a disc sends
# more than half of them.
SENDING_SHARE = 0.35

# Standard deviations above the background from which the events around a marker tell of it.
CLEAR_SIGMAS = 3.0

# Largest distance of a marker from the middle of its neighbours, as a share of their mean
# distance, at which they surround it: 0 inside of a square grid, 0.6 at its border.
SURROUNDED = 0.25


class TrackManager:
    """Keeps the identities of one sensor's markers.

    Attributes:
        neighbours: What markers say of each other.
        coasted: ``(m,)`` markers that are predicted, not observed.
        silent: ``(m,)`` markers that do not send what their neighbours' motion asks for.
        placed: Whether the last judgement placed any marker.
        moved: ``(m,)`` markers that it placed somewhere else.
        position_px: ``(m, 2)`` where it placed them.
        capture_px: Largest distance between a prediction and a detection that is taken, px.
    """

    def __init__(self, calibration: Calibration) -> None:
        """Begin with every marker observed at its reference."""
        count = len(calibration.reference_px)
        self.neighbours = Neighbourhood(calibration.reference_px)
        around_px = calibration.reference_px[self.neighbours.index]
        around_px = around_px - calibration.reference_px[:, np.newaxis]
        away_px = np.linalg.norm(around_px.mean(axis=1), axis=1)
        spread_px = np.linalg.norm(around_px, axis=2).mean(axis=1)
        self._surrounded = away_px < SURROUNDED * spread_px
        self._areas_px = blob_areas_px(calibration.radius_px)
        spacing_px = min(smallest_spacing_px(calibration.reference_px), max(calibration.size))
        self.capture_px = CAPTURE_SHARE * spacing_px
        self._doubted_since_us = np.full(count, NEVER_US, np.int64)
        self._search_at_us = NEVER_US
        self._unheard_px, self._trust = np.zeros(count), np.ones(count)
        self.coasted, self.silent, self.moved = np.zeros((3, count), np.bool_)
        self.placed = False
        self.position_px = calibration.reference_px.copy()

    def listen(
        self,
        motion: NDArray[np.float64],
        counts: NDArray[np.int64],
        dt_s: float,
        kept: EventLoss,
    ) -> None:
        """Compare the events of each marker with those that its neighbours' motion asks for.

        Args:
            motion: ``(m, 8)`` states of the markers (:mod:`spikingtac.markers.graded.motion`).
            counts: ``(m + 1,)`` events around each marker, and around none.
            dt_s: Time in which they came, s.
            kept: How many events of a whole stream arrive, and how many are background.
        """
        near = self.neighbours
        listen_kernel(
            motion, near.index, near.weight, self._surrounded, counts, kept.noise_per_s,
            kept.events_per_px, kept.share, dt_s, self._unheard_px, self.silent,
        )  # fmt: skip

    def judge(self, t_us: int, fits: NDArray[np.float64], levels: NDArray[np.float32]) -> None:
        """Decide which markers are held at ``t_us`` and look for those that are.

        Args:
            t_us: Time of the estimate, us.
            fits: ``(m, 7)`` places of the fits, px, and how well they agree
                (:mod:`spikingtac.markers.graded.motion`).
            levels: ``(height, width)`` the map.
        """
        self.placed, near, since_us = False, self.neighbours, self._doubted_since_us
        gone = self.coasted, self.silent
        if not doubt_kernel(fits, near.skin, near.bound_px, gone, t_us, since_us):
            return
        fitted_px = fits[:, :FIT_US]
        lost = (since_us > NEVER_US) & (t_us - since_us >= PATIENCE_US)
        self.coasted |= lost | self.silent
        self.moved[:] = self.coasted
        if self.coasted.any():
            blended_px = np.where(self.coasted[:, np.newaxis], self.position_px, fitted_px)
            self.position_px[self.coasted] = near.expected_px(blended_px)[self.coasted]
            self.placed = True
            if t_us >= self._search_at_us:
                self._search_at_us = t_us + SEARCH_US
                self._search(fitted_px, levels)

    def confidence(self, agreement: NDArray[np.float64], dt_s: float) -> NDArray[np.float64]:
        """Return ``(m,)`` how well each marker is supported, 0 to 1.

        Args:
            agreement: ``(m,)`` share of each edge that agrees with its disc.
            dt_s: Time since the last call, s.
        """
        confidence = np.empty(len(agreement))
        trust_kernel(agreement, self._unheard_px, self.coasted, self._trust, dt_s, confidence)
        return confidence

    def _search(self, fitted_px: NDArray[np.float64], levels: NDArray[np.float32]) -> None:
        blobs = find_blobs(levels, areas_px=self._areas_px)
        expected_px = np.where(self.coasted[:, np.newaxis], self.position_px, fitted_px)
        match = associate(expected_px, blobs.center_px, self.capture_px)
        found = self.coasted & ~self.silent & (match != UNMATCHED)
        self.position_px[found] = blobs.center_px[match[found]]
        self.coasted &= ~found
        self._doubted_since_us[found] = NEVER_US


@kernel()
def trust_kernel(
    agreement: Array, unheard_px: Array, coasted: Array, trust: Array, dt_s: float,
    confidence: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Write how well each marker is supported; the trust in those that are not seen fades."""
    fading = np.exp(-dt_s / FADE_S)
    for m in range(trust.size):
        trust[m] = trust[m] * fading if coasted[m] else 1.0
        confidence[m] = agreement[m] * trust[m] * max(1.0 - unheard_px[m] / SILENT_PX, 0.0)


@kernel()
def _asked_speed_kernel(
    motions: Array, index: Array, weight: Array, m: int
) -> float:  # pragma: no cover - compiled
    """Return the speed that a marker's neighbours vouch for, px/s.

    Two of them may rest without acquitting it: they may be gone as well.
    """
    x = y = 0.0
    slowest = second = third = np.inf
    for k in range(index.shape[1]):
        n = index[m, k]
        x += weight[m, k] * motions[n, VX]
        y += weight[m, k] * motions[n, VY]
        speed_px_s = np.sqrt(motions[n, VX] ** 2 + motions[n, VY] ** 2)
        third = min(third, max(second, speed_px_s))
        second = min(second, max(slowest, speed_px_s))
        slowest = min(slowest, speed_px_s)
    few = second if index.shape[1] == 2 else slowest
    return min(third if index.shape[1] > 2 else few, np.sqrt(x * x + y * y))


@kernel()
def doubt_kernel(
    fits: Array, skin: tuple[Array, Array, Array], bound_px: Array, gone: tuple[Array, Array],
    t_us: int, since_us: Array,
) -> bool:  # pragma: no cover - compiled # fmt: skip
    """Note since when fits cannot be their markers, NEVER_US for all others.

    Returns whether there are any, or markers that are ``gone``: held, or silent.
    """
    found = False
    for m in range(bound_px.size):
        beyond2 = 0.0
        for axis in range(2):
            _, low, high = around_kernel(fits, skin, m, axis)
            moved = fits[m, FIT_X + axis] - skin[0][m, axis]
            beyond2 += max(low - moved, moved - high, 0.0) ** 2
        if beyond2 <= bound_px[m] ** 2 and fits[m, AGREEMENT] >= LEAST_AGREEMENT:
            since_us[m] = NEVER_US
        elif since_us[m] == NEVER_US:
            since_us[m] = t_us
        found = found or since_us[m] > NEVER_US or gone[0][m] or gone[1][m]
    return found


@kernel()
def listen_kernel(
    motions: Array, index: Array, weight: Array, surrounded: Array, events: Array,
    noise_per_s: Array, whole_per_px: Array, share: float, dt_s: float, unheard_px: Array,
    silent: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Add up the travel without events, px, and mark who is silent.

    Arguments are plain, since a tuple costs a microsecond: motions; neighbours, their weights, and
    who is surrounded by them; events around each, background per s, and events of a whole stream
    per px of motion; the share that arrives, and the time, s; the travel and who is silent, which
    are changed.
    """
    for m in range(silent.size):
        events_per_px = share * whole_per_px[m]
        asked = _asked_speed_kernel(motions, index, weight, m)
        noise = noise_per_s[m] * dt_s
        told = SLOW_PX_S < asked < FAST_PX_S
        told = told and asked * events_per_px > BACKGROUND_SHARE * noise_per_s[m]
        # A marker whose neighbours are held, too, is heard by its own events alone.
        if not told and events[m] <= noise + CLEAR_SIGMAS * np.sqrt(noise + 1.0):
            continue
        sent_px = (events[m] - noise) / events_per_px
        travel_px = asked * dt_s if told else 0.0
        unheard = unheard_px[m] + travel_px - sent_px / SENDING_SHARE
        unheard_px[m] = min(max(unheard, 0.0), 2.0 * SILENT_PX)
        limit_px = 0.5 * SILENT_PX if silent[m] else SILENT_PX
        silent[m] = surrounded[m] and unheard_px[m] > limit_px
