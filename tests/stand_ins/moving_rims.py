"""Windows of a small sensor whose markers move together, with the noise of pixels: no optics."""

from collections.abc import Callable, Iterator

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.types import EventPacket
from stand_ins.known import known
from stand_ins.random_packets import packet_of

SIZE = (130, 130)
RADIUS_PX = 7.0
GRID = 28.0 + 37.0 * np.stack(np.divmod(np.arange(9.0), 3.0)[::-1], axis=1)
PERIOD_US = 1000
VOTES_PER_PX = 200.0  # Events of one marker per px of motion: 2 d ln C / theta.

# Window number -> speed of every marker, px per window.
Speed = Callable[[int], tuple[float, float]]


def calibration() -> Calibration:
    return known(GRID, RADIUS_PX, SIZE)


def still(window: int) -> tuple[float, float]:
    return 0.0, 0.0


def windows(
    count: int, seed: int, speed: Speed = still, noise: float = 4.0, first: int = 0
) -> Iterator[EventPacket]:
    """Yield windows: ``noise`` events each anywhere, and those of the markers' motion.

    A marker off its rest makes the outside of its rim brighter, ahead, and the inside darker.
    """
    rng, moved = np.random.default_rng(seed), np.zeros(2)
    for number in range(first, first + count):
        anywhere = rng.poisson(noise)
        x, y = (list(rng.integers(0, side, anywhere)) for side in SIZE)
        p = list(rng.random(anywhere) < 0.6)
        velocity = np.array(speed(number))
        moved = moved + velocity
        for _ in range(rng.poisson(np.hypot(*velocity) * VOTES_PER_PX * len(GRID))):
            center, angle = GRID[rng.integers(len(GRID))], rng.uniform(0.0, 2.0 * np.pi)
            normal = np.array([np.cos(angle), np.sin(angle)])
            if rng.random() > abs(normal @ velocity) / np.hypot(*velocity):
                continue
            depth = 0.5 if normal @ (moved - 0.5 * velocity) > 0.0 else -0.5
            at = np.rint(center + (RADIUS_PX + depth) * normal).astype(int)
            x.append(at[0])
            y.append(at[1])
            p.append(bool(normal @ velocity > 0.0))
        start = PERIOD_US * number
        t = np.sort(rng.integers(start, start + PERIOD_US, len(x)))
        span_us = start, start + PERIOD_US
        yield packet_of(t, np.array(x), np.array(y), np.array(p), SIZE, span_us)
