"""The watch for pixels that become hot later, against counts in plain numbers."""

import numpy as np
import pytest

from spikingtac.events.hot_pixels import (
    NEAR_PX,
    OVER_NEIGHBOURS,
    WATCH_EVENTS,
    WATCH_US,
    WATCH_WINDOWS,
    HotPixelWatch,
)
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.types import EventPacket
from stand_ins.random_packets import cut_at, packet_of
from stand_ins.rare_off import RADIUS_PX, REST_PX, rare_off_calibration, rare_off_events
from stand_ins.rare_off import SIZE as PRESSED_SIZE

SIZE = (12, 9)
CUTS = (1, 7, 250, 100_000)


def packet(
    x: np.ndarray, y: np.ndarray, t: np.ndarray, size: tuple[int, int] = SIZE
) -> EventPacket:
    order = np.argsort(t, kind="stable")
    return packet_of(t[order], x[order], y[order], np.arange(len(t)) % 2 == 0, size)


def sending(x: int, y: int, rate_hz: float, span_s: tuple[float, float]) -> np.ndarray:
    t = np.arange(span_s[0] * 1e6, span_s[1] * 1e6, 1e6 / rate_hz)
    return np.column_stack([np.full(len(t), x), np.full(len(t), y), t]).astype(np.int64)


def plain(events: EventPacket, known: set[tuple[int, int]]) -> tuple[list[int], int]:
    """Return the indices of the kept events, and how many pixels became hot."""
    hot, busy, kept = set(known), {}, []
    windows = events.t // WATCH_US
    places = list(zip(events.x.tolist(), events.y.tolist(), strict=True))
    for window in range(int(windows[0]), int(windows[-1]) + 1):
        inside = [i for i in np.flatnonzero(windows == window).tolist() if places[i] not in hot]
        kept += inside
        counts = {place: 0 for place in busy}
        for i in inside:
            counts[places[i]] = counts.get(places[i], 0) + 1
        if window == int(windows[-1]):
            break
        for (x, y), count in counts.items():
            around = [
                counts.get((x + i, y + j), 0)
                for i in range(-NEAR_PX, NEAR_PX + 1)
                for j in range(-NEAR_PX, NEAR_PX + 1)
                if (i, j) != (0, 0)
            ]
            if count < WATCH_EVENTS:
                busy[x, y] = 0
            elif count > OVER_NEIGHBOURS * max(around):
                busy[x, y] = busy.get((x, y), 0) + 1
        hot |= {place for place, alone in busy.items() if alone >= WATCH_WINDOWS}
    return sorted(kept), len(hot) - len(known)


def kept_by(watch: HotPixelWatch, events: EventPacket, cut: int) -> list[int]:
    """Return the times of the events that are kept of packets of so many events."""
    parts = (events.select(slice(i, i + cut)) for i in range(0, len(events), cut))
    return [int(t) for part in parts for t in watch.kept(part).t]


@pytest.mark.parametrize("seed", range(3))
def test_any_packing_finds_what_plain_counts_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 3_000
    noise = np.column_stack([rng.integers(0, side, count) for side in (*SIZE, 8_000_000)])
    noise = noise[(noise[:, 2] < 5_100_000) | (noise[:, 2] > 6_200_000)]
    hot = [  # three steady ones; a rim in motion, too mild, a burst, on and off are none
        sending(x, y, float(rng.uniform(150, 500)), (float(rng.uniform(0.0, 4.0)), 8.0))
        for x, y in ((0, 0), (10, 2), (6, 7))
    ]
    hot += [sending(x, 4, 200.0, (0.0, 4.0)) for x in range(4, 8)]
    hot += [sending(11, 8, 30.0, (0.0, 4.0)), sending(3, 0, 500.0, (0.0, 1.4))]
    hot += [sending(0, 8, 500.0, (k, k + 0.5)) for k in range(6)]
    x, y, t = np.concatenate([noise, *hot]).T
    events = packet(x, y, t)
    expected, found = plain(events, {(3, 4)})
    assert found >= 2
    for cut in CUTS:
        watch = HotPixelWatch(np.array([[3, 4]]), SIZE)
        assert kept_by(watch, events, cut) == events.t[expected].tolist()
        assert watch.found == found
        assert watch.hot.sum() == found + 1


def test_the_mask_of_a_tracker_depends_on_no_packing_and_a_reset_forgets_it() -> None:
    """Five times three presses; a pixel beside a rim becomes hot after a second."""
    once, end_us, ends = rare_off_events(), 7_500_000, []
    x, y = (np.tile(column, 5).astype(int) for column in (once.x, once.y))
    t = np.concatenate([once.t + 1_500_000 * k for k in range(5)])
    hot = sending(*(REST_PX[0] + [RADIUS_PX + 2, 0]).astype(int), 400.0, (1.0, end_us / 1e6))
    whole = packet(*np.concatenate([np.column_stack([x, y, t]), hot]).T, PRESSED_SIZE)
    tracker = GradedTracker(GradedTrackerConfig(), rare_off_calibration())
    for pieces in (1, 50):
        edges_us = np.linspace(whole.t_start_us, whole.t_end_us, pieces + 1).astype(int).tolist()
        for part in cut_at(whole, edges_us):
            tracker.absorb(part)
        ends.append(tracker.estimate(whole.t_end_us).detected_px)
        assert tracker.hot_pixels == 1
        tracker.reset()
        assert tracker.hot_pixels == 0
    np.testing.assert_array_equal(ends[0], ends[1])
