"""The collection of crossings against plain Python, event by event from the definition."""

from itertools import pairwise

import numpy as np
import pytest

from spikingtac.markers.crossings import (
    JITTER_PX,
    LOOK_BACK_US,
    LOOK_STEP_US,
    ORDERS,
    PLACE_BINS,
    REACH_PX,
    SPEED_EDGES_PX_S,
    MarkerTrack,
    marker_track,
    observe_crossings,
)
from spikingtac.types import EventPacket

SIZE = (64, 40)
MEMORY = 16


def naive(packet: EventPacket, track: MarkerTrack) -> tuple[np.ndarray, np.ndarray]:
    speeds = len(SPEED_EDGES_PX_S) - 1
    count = np.zeros((2, ORDERS, speeds, PLACE_BINS), int)
    total = np.zeros((2, ORDERS, speeds))
    ladders: dict[tuple[int, int], list[int]] = {}
    polarity: dict[tuple[int, int], bool] = {}
    for x, y, p, t in zip(packet.x, packet.y, packet.p, packet.t, strict=True):
        pixel = (int(x), int(y))
        if polarity.get(pixel) != bool(p):
            ladders[pixel] = []
        polarity[pixel] = bool(p)
        ladders[pixel].append(int(t))
        seen = crossing(track, pixel, bool(p), int(t))
        if seen is None:
            continue
        q, speed, entry_us = seen
        order = sum(at >= entry_us for at in ladders[pixel][-MEMORY:]) - 1
        if order < ORDERS:
            side, fast = int(not p), int(np.searchsorted(SPEED_EDGES_PX_S, speed, "right")) - 1
            place = min(int((q + REACH_PX) / (2 * REACH_PX) * PLACE_BINS), PLACE_BINS - 1)
            count[side, order, fast, place] += 1
            total[side, order, fast] += speed
    return count, total


def crossing(
    track: MarkerTrack, pixel: tuple[int, int], p: bool, t: int
) -> tuple[float, float, int] | None:
    at, sign = track.t_us, track.facing
    if not at[0] <= t < at[-1]:
        return None
    row = int(np.searchsorted(at, t, "right")) - 1
    share = (t - at[row]) / (at[row + 1] - at[row])
    velocity = track.velocity_px_s

    def mix(columns: np.ndarray, m: int) -> np.ndarray:
        return (1 - share) * columns[row, m] + share * columns[row + 1, m]

    def place(center: np.ndarray, m: int) -> float:
        return sign * (float(np.hypot(*(np.array(pixel) - center))) - track.radius_px[m])

    for m in range(len(track.radius_px)):
        center = mix(track.center_px, m)
        away = np.array(pixel) - center
        q = place(center, m)
        if not (abs(q) <= REACH_PX and np.hypot(*away) > 1.0):
            continue
        on = 1.0 if p else -1.0
        speed = on * sign * float(mix(velocity, m) @ away) / float(np.hypot(*away))
        if not SPEED_EDGES_PX_S[0] <= speed < SPEED_EDGES_PX_S[-1]:
            return None
        back, last = row, -REACH_PX
        while back >= 0:
            now = on * place(track.center_px[back, m], m)
            if now > REACH_PX:
                return None if at[row] - at[back] > LOOK_BACK_US else (q, speed, int(at[back]))
            if not now >= last - JITTER_PX:
                return None
            last = now
            back -= max(1, LOOK_STEP_US // int(at[1] - at[0]))
        return None
    return None


def example(seed: int, dark: bool, events: int = 6_000) -> tuple[EventPacket, MarkerTrack]:
    """Two discs that swing to and fro, and events along their rims, some of them misplaced."""
    rng = np.random.default_rng(seed)
    t_us = np.arange(50_000, 950_000, 1_000)
    swing = np.stack([np.sin(t_us / 8e4), 0.6 * np.cos(t_us / 7e4)], axis=1) * 7.0
    center = np.array([[18.0, 20.0], [46.0, 19.0]]) + swing[:, None]
    center += rng.normal(0.0, 0.004, center.shape)
    center[300:330, 1] = np.nan
    radius = np.array([6.5, 5.8])
    t = np.sort(rng.integers(0, 1_000_000, events))
    disc = rng.integers(0, 2, events)
    row = np.clip(np.searchsorted(t_us, t), 0, len(t_us) - 1)
    angle = rng.uniform(0, 2 * np.pi, events)
    rim = (radius[disc] + rng.normal(0, 1.5, events))[:, None]
    at = np.nan_to_num(center[row, disc], nan=30.0)
    at = at + rim * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, y = np.clip(np.round(at), 0, np.array(SIZE) - 1).astype(np.uint16).T
    p = rng.random(events) < 0.5
    return EventPacket(x, y, p, t, 0, 1_000_000, SIZE), marker_track(t_us, center, radius, dark)


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_kernel_and_plain_python_agree(seed: int, dark: bool) -> None:
    packet, track = example(seed, dark)
    found = observe_crossings([packet], track, SIZE)
    count, total = naive(packet, track)
    assert count.sum() > 300, "the example tells nothing"
    assert (found.count == count).all()
    np.testing.assert_allclose(found.speed_sum_px_s, total, rtol=1e-9)


def test_any_cut_into_packets_gives_the_same() -> None:
    packet, track = example(2, False)
    whole = observe_crossings([packet], track, SIZE)
    cuts = pairwise([0, 1, 1, 700, 701, 4_000, len(packet)])
    parts = [packet.part(first, last, 0, 1_000_000) for first, last in cuts]
    found = observe_crossings(parts, track, SIZE)
    assert (found.count == whole.count).all()
    assert (found.speed_sum_px_s == whole.speed_sum_px_s).all()
