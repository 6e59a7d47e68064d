"""Markers that should send events and do not: paint that is gone.

A map painted from a calibration holds a disc for each marker, and where a marker came off no event
ever contradicts it: its fit agrees for ever with what was painted. But the skin moves there, as the
neighbours show, and a disc that moves sends events. A marker whose cell stays near its background
while its neighbours' motion asks for events is silent. How far it should move is taken with care:
the speed that the neighbours' affine motion predicts (the centre of a rotation rests), and no more
than nearly all of them have (at the rim of a touch some rest). Markers at the border are not
judged: motion dies away towards it, and no neighbour stands beyond to vouch for it. Ours.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.event_loss import BACKGROUND_SHARE, SLOW_PX_S, CellCounts
from spikingtac.markers.neighbours import Neighbourhood

RESTING_NEIGHBOURS = 2
"""Neighbours that may rest without acquitting a marker: they may be gone as well."""

SURROUNDED = 0.25
"""Largest distance of a marker from the middle of its neighbours, as a share of their mean
distance, at which they surround it: 0 inside of a square grid, 0.6 at its border."""

LEAST_TRAVEL_PX = 2.0
"""Travel of the skin before a marker is judged: several reversals' worth of dead band."""

MEMORY_TRAVEL_PX = 8.0
"""Travel over which the share is averaged."""

SILENT_SHARE = 0.2
"""Below this share of the events that it should send, a marker is silent; half a disc sends more
than half of a whole one's."""

HEARD_SHARE = 0.5
"""Above this share a silent marker counts as heard again."""


class MissingMarkers:
    """Watches for markers that are gone.

    Attributes:
        silent: ``(m,)`` markers that do not send what their neighbours' motion asks for.
    """

    def __init__(self, calibration: Calibration) -> None:
        """Begin by believing in every marker."""
        count = len(calibration.reference_px)
        self._neighbours = Neighbourhood(calibration.reference_px)
        self._surrounded = _surrounded(calibration.reference_px, self._neighbours.index)
        self._asked, self._arrived = np.zeros(count), np.zeros(count)
        self.silent = np.zeros(count, np.bool_)

    def update(
        self, velocity_px_s: NDArray[np.float64], cells: CellCounts, share: float
    ) -> NDArray[np.bool_]:
        """Judge the events since the last call and return :attr:`silent`.

        Args:
            velocity_px_s: ``(m, 2)`` the markers' velocities, px/s.
            cells: What arrived around each of them.
            share: Events that arrive over those that a whole stream would bring.
        """
        _watch_kernel(
            velocity_px_s,
            self._neighbours.index,
            self._neighbours.weight,
            self._surrounded,
            cells.events,
            cells.noise_per_s,
            cells.events_per_px,
            share,
            cells.dt_s,
            self._asked,
            self._arrived,
            self.silent,
        )
        return self.silent


def _surrounded(
    reference_px: NDArray[np.float64], neighbours: NDArray[np.int64]
) -> NDArray[np.bool_]:
    offset = reference_px[neighbours] - reference_px[:, np.newaxis]
    away_px = np.linalg.norm(offset.mean(axis=1), axis=1)
    return away_px < SURROUNDED * np.linalg.norm(offset, axis=2).mean(axis=1)


@njit(cache=True, nogil=True)
def _expected_velocity_kernel(
    velocity_px_s: NDArray[np.float64], neighbours: NDArray[np.int64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:  # pragma: no cover - compiled
    """Return ``(m, 2)`` the velocity that the neighbours' affine motion predicts, px/s."""
    out = np.zeros_like(velocity_px_s)
    for m in range(velocity_px_s.shape[0]):
        for k in range(neighbours.shape[1]):
            for axis in range(2):
                out[m, axis] += weight[m, k] * velocity_px_s[neighbours[m, k], axis]
    return out


@njit(cache=True, nogil=True)
def _asked_speed_kernel(
    velocity_px_s: NDArray[np.float64],
    expected_px_s: NDArray[np.float64],
    neighbours: NDArray[np.int64],
) -> NDArray[np.float64]:  # pragma: no cover - compiled
    """Return ``(m,)`` the speed that each marker's neighbours vouch for, px/s."""
    count = velocity_px_s.shape[0]
    speed, out = np.empty(count), np.empty(count)
    for m in range(count):
        speed[m] = np.hypot(velocity_px_s[m, 0], velocity_px_s[m, 1])
    slowest = np.empty(min(RESTING_NEIGHBOURS + 1, neighbours.shape[1]))
    for m in range(count):
        slowest[:] = np.inf
        for k in range(neighbours.shape[1]):
            rising = speed[neighbours[m, k]]  # sorted in: np.sort would compile for seconds
            for place in range(slowest.size):
                rising, slowest[place] = max(rising, slowest[place]), min(rising, slowest[place])
        out[m] = min(slowest[-1], np.hypot(expected_px_s[m, 0], expected_px_s[m, 1]))
    return out


@njit(cache=True, nogil=True)
def _judge_kernel(
    speed_px_s: NDArray[np.float64],
    cells: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]],
    sums: tuple[NDArray[np.float64], NDArray[np.float64]],
    share: float,
    dt_s: float,
    silent: NDArray[np.bool_],
) -> None:  # pragma: no cover - compiled
    """Add up what was asked and what arrived (``sums``), and mark the silent markers."""
    events, noise_per_s, events_per_px = cells
    asked, arrived = sums
    for m in range(speed_px_s.size):
        rate = share * events_per_px[m] * speed_px_s[m]
        if speed_px_s[m] <= SLOW_PX_S or rate <= BACKGROUND_SHARE * noise_per_s[m]:
            continue
        full = share * events_per_px[m]
        kept = 1.0 - min(rate * dt_s / (MEMORY_TRAVEL_PX * full), 1.0)
        asked[m] = kept * asked[m] + rate * dt_s
        arrived[m] = kept * arrived[m] + events[m] - noise_per_s[m] * dt_s
        if asked[m] > LEAST_TRAVEL_PX * full:
            limit = HEARD_SHARE if silent[m] else SILENT_SHARE
            silent[m] = arrived[m] < limit * asked[m]


@njit(cache=True, nogil=True)
def _watch_kernel(
    velocity_px_s: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    weight: NDArray[np.float64],
    surrounded: NDArray[np.bool_],
    events: NDArray[np.int64],
    noise_per_s: NDArray[np.float64],
    events_per_px: NDArray[np.float64],
    share: float,
    dt_s: float,
    asked: NDArray[np.float64],
    arrived: NDArray[np.float64],
    silent: NDArray[np.bool_],
) -> None:  # pragma: no cover - compiled
    """Do all of the above in one call: each one from Python costs as much as what it does."""
    expected = _expected_velocity_kernel(velocity_px_s, neighbours, weight)
    speed_px_s = _asked_speed_kernel(velocity_px_s, expected, neighbours)
    for m in range(speed_px_s.size):
        speed_px_s[m] *= surrounded[m]
    cells, sums = (events, noise_per_s, events_per_px), (asked, arrived)
    _judge_kernel(speed_px_s, cells, sums, share, dt_s, silent)
