"""Ideal discs on a small sensor that slide to all sides and rest in between, with some noise."""

from functools import cache

import numpy as np

from spikingtac.types import EventPacket
from stand_ins.ideal_events import ideal_events
from stand_ins.random_packets import cut_at, packet_of

SIZE, GRID, PITCH_PX, RADIUS_PX = (182, 144), (3, 4), 38.0, 7.0
MARKERS = GRID[0] * GRID[1]
STEPS, STEP_US, REST_US = 30, 4_000, 600_000
FAR_PX = 18.0
WAYS = ((1, 0), (-1, 0), (0, 1), (0, -1))


def resting_px() -> np.ndarray:
    row, column = np.divmod(np.arange(MARKERS), GRID[1])
    spread = np.column_stack([column - (GRID[1] - 1) / 2, row - (GRID[0] - 1) / 2])
    return spread * PITCH_PX + (np.array(SIZE) - 1) / 2


def trip(way: tuple[float, float], moved: np.ndarray | float = 1.0) -> np.ndarray:
    """A path of all markers to one side and back, each by its share of the way."""
    along = FAR_PX * np.sin(np.linspace(0, np.pi, STEPS)) ** 2
    share = np.broadcast_to(moved, MARKERS)
    return resting_px() + along[:, None, None] * np.array(way) * share[:, None]


def packets_of_trips(trips: list[np.ndarray], noise_hz: float = 0.2) -> list[EventPacket]:
    """Packets of trips with rests before, between and after them."""
    rng = np.random.default_rng(3)
    path = np.concatenate(trips)
    events = ideal_events(path, RADIUS_PX, SIZE, STEP_US)
    t = events.t + (1 + events.t // (STEPS * STEP_US)) * REST_US
    end_us = len(path) * STEP_US + (len(trips) + 1) * REST_US
    count = rng.poisson(noise_hz * SIZE[0] * SIZE[1] * end_us / 1e6)
    x, y = (
        np.append(known, rng.integers(0, side, count))
        for known, side in zip((events.x, events.y), SIZE, strict=True)
    )
    p = np.append(events.p, rng.random(count) < 0.5)
    t = np.append(t, rng.integers(0, end_us, count))
    order = np.argsort(t, kind="stable")
    whole = packet_of(*(column[order] for column in (t, x, y, p)), SIZE, (0, end_us))
    return cut_at(whole, [*range(0, end_us, 20_000), end_us])


@cache
def sliding_packets() -> list[EventPacket]:
    """Slides of all markers to the four sides."""
    return packets_of_trips([trip(way) for way in WAYS])
