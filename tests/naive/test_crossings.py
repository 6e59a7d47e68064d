"""The collection of crossings against plain Python, event by event from the definition."""

from itertools import pairwise

import numpy as np
import pytest

from spikingtac.markers.crossings import (
    JITTER_PX,
    LOOK_BACK,
    LOOK_STEP,
    ORDERS,
    PERIOD_US,
    PLACE_BINS,
    REACH_PX,
    SPEED_EDGES_PX_S,
    SPEED_SPAN,
    MarkerTrack,
    crossings,
)
from spikingtac.types import EventPacket

SIZE = (64, 40)


def naive(packet: EventPacket, track: MarkerTrack) -> tuple[np.ndarray, np.ndarray]:
    speeds = len(SPEED_EDGES_PX_S) - 1
    count = np.zeros((2, ORDERS, speeds, PLACE_BINS), int)
    total = np.zeros(speeds)
    series: dict[tuple[int, int], list[tuple[bool, int]]] = {}
    for x, y, p, t in zip(packet.x, packet.y, packet.p, packet.t, strict=True):
        pixel, event = (int(x), int(y)), (bool(p), int(t))
        before = series.setdefault(pixel, [])
        if before and (before[-1][0] != p or t - before[-1][1] > LOOK_BACK * PERIOD_US):
            before.clear()
        before.append(event)
        seen = crossing(track, pixel, *event)
        if seen is not None and len(before) <= ORDERS:
            q, speed = seen
            side, fast = int(not p), int(np.searchsorted(SPEED_EDGES_PX_S, speed, "right")) - 1
            place = min(int((q + REACH_PX) / (2 * REACH_PX) * PLACE_BINS), PLACE_BINS - 1)
            count[side, len(before) - 1, fast, place] += 1
            total[fast] += speed
    return count, total / np.maximum(count.sum(axis=(0, 1, 3)), 1)


def crossing(
    track: MarkerTrack, pixel: tuple[int, int], p: bool, t: int
) -> tuple[float, float] | None:
    row = int(np.searchsorted(track.t_us, t, "right")) - 1
    if row < SPEED_SPAN or row + SPEED_SPAN >= len(track.t_us):
        return None
    share = (t - track.t_us[row]) / PERIOD_US

    def place(at: int, m: int) -> float:
        away_px = float(np.hypot(*(np.array(pixel) - track.center_px[at, m])))
        return track.facing * (away_px - track.radius_px[m])

    for m in range(len(track.radius_px)):
        q = (1 - share) * place(row, m) + share * place(row + 1, m)
        if not abs(q) <= REACH_PX:
            continue
        on = 1.0 if p else -1.0
        moved = place(row - SPEED_SPAN, m) - place(row + SPEED_SPAN, m)
        speed = on * moved / (2 * SPEED_SPAN * PERIOD_US * 1e-6)
        if not SPEED_EDGES_PX_S[0] <= speed < SPEED_EDGES_PX_S[-1]:
            return None
        last = -REACH_PX
        for back in range(row, max(row - LOOK_BACK, 0) - 1, -LOOK_STEP):
            now = on * place(back, m)
            if now > REACH_PX:
                return q, speed
            if not now >= last - JITTER_PX:
                return None
            last = now
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
    track = MarkerTrack(t_us, center, radius, -1.0 if dark else 1.0)
    return EventPacket(x, y, p, t, 0, 1_000_000, SIZE), track


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_kernel_and_plain_python_agree(seed: int, dark: bool) -> None:
    packet, track = example(seed, dark)
    found, speeds_px_s = crossings([packet], track, SIZE)
    count, mean_px_s = naive(packet, track)
    assert count.sum() > 300, "the example tells nothing"
    assert (found == count).all()
    np.testing.assert_allclose(speeds_px_s, mean_px_s, rtol=1e-9)


def test_any_cut_into_packets_gives_the_same() -> None:
    packet, track = example(2, False)
    whole = crossings([packet], track, SIZE)
    cuts = pairwise([0, 1, 1, 700, 701, 4_000, len(packet)])
    parts = [packet.part(first, last, 0, 1_000_000) for first, last in cuts]
    found = crossings(parts, track, SIZE)
    assert (found[0] == whole[0]).all()
    assert (found[1] == whole[1]).all()
