"""Track management: which markers are tracked, which are lost, and how lost ones are found again.

A marker is lost when its fit disagrees with the map, or when it is silent while its neighbours
move. It is also lost when its displacement leaves the range of their displacements by more than
:data:`spikingtac.markers.neighbours.FARTHEST_PITCHES`.

A lost marker coasts: its position is predicted from its neighbours, and a detector searches the
whole map for it at a low rate. A detection is accepted only within a gate around the prediction,
and only if the marker is not silent. Nor may another marker be associated with it, so that
identities cannot swap.

The silence test finds markers that came off the skin. The map was painted with a disc for each
marker, and no event ever contradicts a disc that no longer exists. But where the neighbours move,
an existing disc would move and send events. The travel that the neighbours predict and no events
confirm is summed up (a CUSUM test, Page 1954, doi:10.1093/biomet/41.1-2.100). The prediction is
cautious: it is the speed of the neighbours' affine motion (the centre of a rotation rests), but no
more than the speed of nearly all of them (at the rim of a touch some rest). At the border motion
dies away and no neighbours stand beyond, so border markers are never lost for silence alone; their
confidence falls.
"""

from typing import Any

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
from spikingtac.markers.graded.motion import NEVER_US
from spikingtac.markers.neighbours import Neighbourhood, smallest_spacing_px
from spikingtac.state_map.graded import Array
from spikingtac.types import FloatArray

LEAST_AGREEMENT = 0.35  # Share of the edge that must agree with the fitted disc.

LOST_AFTER_US = 20_000  # Time of rejected fits after which a marker is lost, us.

SEARCH_US = 20_000  # Time between two detections in the whole map while a marker is lost, us.

# Radius of the gate around a lost marker's prediction, as a share of the smallest spacing.
CAPTURE_SHARE = 0.3

# Time constant with which the confidence in a lost marker, and in all while the stream is silent,
# decays, s, and the way after a silence over which it comes back, px: what moved meanwhile is seen
# when it moves again.
FADE_S, REGAIN_PX = 0.1, 5.0
LEAST_DOUBT = 1e-3  # Largest doubt of a marker that is none any more.

# Threshold of the silence test: travel without events of the marker's own, px. Its confidence
# falls with the travel (a reversal costs up to half a px).
SILENT_PX = 2.0

# Share of its expected events with which a marker just passes the silence test: half of a disc
# sends more than half of them.
SENDING_SHARE = 0.35

# Standard deviations above the background from which the events in a gate are the marker's own.
CLEAR_SIGMAS = 3.0

# Largest distance of a marker from the centroid of its neighbours, as a share of their mean
# distance, at which they surround it: 0 inside of a square grid, 0.6 at its border.
SURROUNDED = 0.25


class TrackManager:
    """Decides which of one sensor's markers are lost, and finds them again.

    Attributes:
        neighbours: Predicts each marker's displacement from its neighbours.
        coasted: ``(m,)`` lost markers: predicted, not observed.
        silent: ``(m,)`` markers that do not send the events that their neighbours' motion predicts.
        doubt: ``(m,)`` share of the confidence that a silence of the camera has taken, or None.
        position_px: ``(m, 2)`` where lost markers were predicted or found last, px.
        capture_px: Radius of the gate around a prediction within which a detection is accepted, px.
    """

    def __init__(self, calibration: Calibration) -> None:
        """Begin with every marker observed at its reference."""
        count = len(calibration.reference_px)
        self.neighbours = Neighbourhood(calibration.reference_px)
        around_px = calibration.reference_px[self.neighbours.index]
        around_px = around_px - calibration.reference_px[:, np.newaxis]
        away_px = np.linalg.norm(around_px.mean(axis=1), axis=1)
        self._surrounded = away_px < SURROUNDED * np.linalg.norm(around_px, axis=2).mean(axis=1)
        self._areas_px = blob_areas_px(calibration.radius_px)
        spacing_px = min(smallest_spacing_px(calibration.reference_px), max(calibration.size))
        self.capture_px = CAPTURE_SHARE * spacing_px
        self._rejected_since_us = np.full(count, NEVER_US, np.int64)
        self._search_at_us = NEVER_US
        self._cusum_px, self._trust = np.zeros(count), np.ones(count)
        self.doubt: FloatArray | None = None
        self.coasted, self.silent = np.zeros((2, count), np.bool_)
        self.position_px = calibration.reference_px.copy()
        self._fitted_px = np.empty_like(self.position_px)

    def update_silent(
        self, markers: Array, counts: Array, dt_s: float, event_loss: EventLoss
    ) -> None:
        """Test for silence: compare the events of each marker with its neighbours' motion.

        Args:
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            counts: ``(m + 1,)`` events in each marker's gate, and last those in no gate.
            dt_s: Time in which they came, s.
            event_loss: Share of the events that arrives, and the background.
        """
        near = self.neighbours
        silence_kernel(
            markers, near.index, near.weight, self._surrounded, counts, event_loss.noise_per_s,
            event_loss.events_per_px, event_loss.arrival_ratio, dt_s, self._cusum_px, self.silent,
        )  # fmt: skip

    def update(
        self, t_us: int, markers: NDArray[np.void], levels: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Decide which markers are lost at ``t_us``, predict those, and search the map for them.

        Args:
            t_us: Time of the estimate, us.
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            levels: ``(height, width)`` the map.

        Returns:
            ``(m,)`` markers with a new position in ``position_px``.
        """
        near, since_us, fitted_px = self.neighbours, self._rejected_since_us, self._fitted_px
        flags = self.coasted, self.silent
        if not gate_kernel(markers, near.arrays, near.bound_px, flags, t_us, since_us, fitted_px):
            return self.coasted
        lost = (since_us > NEVER_US) & (t_us - since_us >= LOST_AFTER_US)
        self.coasted |= lost | self.silent
        relocated = self.coasted.copy()
        if relocated.any():
            blended_px = np.where(self.coasted[:, np.newaxis], self.position_px, fitted_px)
            self.position_px[self.coasted] = near.expected_px(blended_px)[self.coasted]
            if t_us >= self._search_at_us:
                self._search_at_us = t_us + SEARCH_US
                self._search(fitted_px, levels)
        return relocated

    def confidence(self, markers: NDArray[np.void], dt_s: float, silent: bool) -> FloatArray:
        """Return ``(m,)`` the confidence in each marker's position, 0 to 1.

        Args:
            markers: ``(m,)`` records (:data:`~spikingtac.markers.graded.motion.MARKER`).
            dt_s: Time since the last call, s.
            silent: Whether the camera sends nothing, not even noise.
        """
        confidence = np.empty(len(markers))
        states = self._cusum_px, self.coasted, self._trust
        confidence_kernel(markers["agreement"], *states, dt_s, confidence)
        if silent or self.doubt is not None:
            confidence *= 1.0 - self._update_doubt(markers, dt_s, silent)
        return confidence

    def _update_doubt(self, markers: NDArray[np.void], dt_s: float, silent: bool) -> FloatArray:
        """Let the doubt grow in a silence, and shrink as markers move after it."""
        doubt = np.zeros(len(markers)) if self.doubt is None else self.doubt
        if silent:
            doubt = 1.0 - (1.0 - doubt) * np.exp(-dt_s / FADE_S)
        else:
            way_px = dt_s * np.hypot(markers["vx"], markers["vy"])
            doubt = doubt * np.exp(-way_px / REGAIN_PX)
        self.doubt = doubt if doubt.max() > LEAST_DOUBT else None
        return doubt

    def _search(self, fitted_px: FloatArray, levels: NDArray[np.float32]) -> None:
        blobs = find_blobs(levels, areas_px=self._areas_px)
        expected_px = np.where(self.coasted[:, np.newaxis], self.position_px, fitted_px)
        match = associate(expected_px, blobs.center_px, self.capture_px)
        found = self.coasted & ~self.silent & (match != UNMATCHED)
        self.position_px[found] = blobs.center_px[match[found]]
        self.coasted &= ~found
        self._rejected_since_us[found] = NEVER_US


@kernel()
def confidence_kernel(
    agreement: Array, cusum_px: Array, coasted: Array, trust: Array, dt_s: float,
    confidence: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Write the confidence in each marker's position; it decays while a marker is lost."""
    fading = np.exp(-dt_s / FADE_S)
    for m in range(trust.size):
        trust[m] = trust[m] * fading if coasted[m] else 1.0
        confidence[m] = agreement[m] * trust[m] * max(1.0 - cusum_px[m] / SILENT_PX, 0.0)


@kernel()
def _expected_speed_kernel(
    markers: Array, index: Array, weight: Array, m: int
) -> float:  # pragma: no cover - compiled
    """Return a cautious prediction of a marker's speed from its neighbours, px/s.

    It is the speed of their affine motion, and at most the third smallest of their speeds: up to
    two of them may rest, since they may have come off as well.
    """
    x = y = 0.0
    slowest = second = third = np.inf
    for k in range(index.shape[1]):
        neighbour: Any = markers[index[m, k]]
        x += weight[m, k] * neighbour.vx
        y += weight[m, k] * neighbour.vy
        speed_px_s = np.sqrt(neighbour.vx**2 + neighbour.vy**2)
        third = min(third, max(second, speed_px_s))
        second = min(second, max(slowest, speed_px_s))
        slowest = min(slowest, speed_px_s)
    few = second if index.shape[1] == 2 else slowest
    return min(third if index.shape[1] > 2 else few, np.sqrt(x * x + y * y))


@kernel()
def gate_kernel(
    markers: Array, neighbours: tuple[Array, Array, Array], bound_px: Array,
    flags: tuple[Array, Array], t_us: int, since_us: Array, fitted_px: Array,
) -> bool:  # pragma: no cover - compiled # fmt: skip
    """Gate the fits: note since when each has been rejected, NEVER_US for accepted ones.

    The fits are copied from the records to ``fitted_px``. Returns whether any fit is rejected, or
    any marker is coasted or silent (``flags``).
    """
    reference_px, index, _ = neighbours
    found = False
    for m in range(bound_px.size):
        fitted_px[m, 0], fitted_px[m, 1] = markers[m].fit_x, markers[m].fit_y
    for m in range(bound_px.size):
        beyond2 = 0.0
        for axis in range(2):
            low, high = np.inf, -np.inf
            for n in index[m]:
                moved = fitted_px[n, axis] - reference_px[n, axis]
                low, high = min(low, moved), max(high, moved)
            moved = fitted_px[m, axis] - reference_px[m, axis]
            beyond2 += max(low - moved, moved - high, 0.0) ** 2
        if beyond2 <= bound_px[m] ** 2 and markers[m].agreement >= LEAST_AGREEMENT:
            since_us[m] = NEVER_US
        elif since_us[m] == NEVER_US:
            since_us[m] = t_us
        found = found or since_us[m] > NEVER_US or flags[0][m] or flags[1][m]
    return found


@kernel()
def silence_kernel(
    markers: Array, index: Array, weight: Array, surrounded: Array, counts: Array,
    noise_per_s: Array, lossless_per_px: Array, ratio: float, dt_s: float, cusum_px: Array,
    silent: Array,
) -> None:  # pragma: no cover - compiled # fmt: skip
    """Update the CUSUM statistics of the silence test, px, and the markers that are silent.

    Arguments are plain, since a tuple costs a microsecond: records of the markers; neighbours,
    their weights, and which markers they surround; events in each gate, background per s, and
    events of a stream without loss per px of motion; the arrival ratio, and the time, s; the
    statistics and the silent markers, which are changed.
    """
    for m in range(silent.size):
        events_per_px = ratio * lossless_per_px[m]
        speed_px_s = _expected_speed_kernel(markers, index, weight, m)
        noise = noise_per_s[m] * dt_s
        observable = SLOW_PX_S < speed_px_s < FAST_PX_S
        observable = observable and speed_px_s * events_per_px > BACKGROUND_SHARE * noise_per_s[m]
        # Where the neighbours predict no motion, only clear events of its own free a marker.
        if not observable and counts[m] <= noise + CLEAR_SIGMAS * np.sqrt(noise + 1.0):
            continue
        confirmed_px = (counts[m] - noise) / events_per_px
        travel_px = speed_px_s * dt_s if observable else 0.0
        cusum = cusum_px[m] + travel_px - confirmed_px / SENDING_SHARE
        cusum_px[m] = min(max(cusum, 0.0), 2.0 * SILENT_PX)
        limit_px = 0.5 * SILENT_PX if silent[m] else SILENT_PX
        silent[m] = surrounded[m] and cusum_px[m] > limit_px
