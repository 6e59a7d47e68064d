"""A noise-free event camera in a few lines, written apart from the package's own twin."""

import numpy as np

from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_of

CONTRAST = 6.0
THRESHOLD = 0.25


def log_image(centers_px: np.ndarray, radius_px: float, size: tuple[int, int]) -> np.ndarray:
    """Return the log intensity of white discs (contrast 6) on a ground of 1."""
    cover = np.zeros((size[1], size[0]))
    reach = int(radius_px) + 2  # nothing of a disc lies beyond: the rest of the image is left out
    for center in np.atleast_2d(centers_px):
        left, top = np.maximum(np.floor(center).astype(int) - reach, 0)
        near = cover[top : int(center[1]) + reach + 1, left : int(center[0]) + reach + 1]
        y, x = np.mgrid[: near.shape[0], : near.shape[1]]
        distance = np.hypot(x + left - center[0], y + top - center[1])
        np.maximum(near, np.clip(radius_px - distance + 0.5, 0.0, 1.0), out=near)
    return np.log(1.0 + (CONTRAST - 1.0) * cover)


def ideal_events(
    path_px: np.ndarray, radius_px: float, size: tuple[int, int], step_us: int = 1_000
) -> EventPacket:
    """Return the events of discs that follow a path.

    Args:
        path_px: (steps, m, 2) centres; the sensor has adapted to the first.
        radius_px: Radius of every disc, px.
        size: (width, height).
        step_us: Time between steps, us.
    """
    reference = log_image(path_px[0], radius_px, size)
    columns: list[np.ndarray] = []
    for step, centers in enumerate(path_px[1:], start=1):
        change = log_image(centers, radius_px, size) - reference
        crossings = np.trunc(change / THRESHOLD).astype(int)
        reference += crossings * THRESHOLD
        y, x = np.nonzero(crossings)
        times = np.abs(crossings[y, x])
        fired = np.stack([x, y, crossings[y, x] > 0, np.full(len(x), step * step_us)])
        columns.append(np.repeat(fired, times, axis=1))
    x, y, p, t = np.concatenate(columns, axis=1)
    return packet_of(t, x, y, p, size, (0, len(path_px) * step_us))
