"""Rate, noise and hot pixels of a camera, from its events alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from spikingtac.events.hot_pixels import find_hot_pixels, hot_mask, quiet_events
from spikingtac.types import EventPacket

US_PER_S = 1_000_000

# Beginning of a recording in which hot pixels are looked for, us (ours: one at 10 Hz sends 300
# events meanwhile).
HOT_PIXEL_US = 30_000_000


@dataclass(frozen=True, slots=True)
class EventQuality:
    """Figures of a stretch of events.

    Attributes:
        rate_hz: Events per second.
        on_fraction: Fraction of ON events; None without events.
        noise_hz: Events per pixel and second in the quietest windows, hot pixels left out.
        hot_px: ``(h, 2)`` columns and rows of hot pixels.
    """

    rate_hz: float
    on_fraction: float | None
    noise_hz: float
    hot_px: NDArray[np.int64]


def judge_events(events: EventPacket) -> EventQuality:
    """Return the figures of a stretch of events.

    Noise is judged in the quietest tenth of the windows of 10 ms; a sensor that never rests
    therefore shows more noise than it has.
    """
    duration_us = max(events.t_end_us - events.t_start_us, 1)
    quiet, quiet_us = quiet_events(events.t, events.t_start_us, events.t_end_us)
    width, height = events.size
    pixel = events.y[quiet].astype(np.int64) * width + events.x[quiet]
    hot_px = find_hot_pixels(pixel, events.size)
    hot = hot_mask(hot_px, events.size).ravel()[pixel]
    usual = width * height - len(hot_px)
    return EventQuality(
        rate_hz=len(events) * US_PER_S / duration_us,
        on_fraction=float(events.p.mean()) if len(events) else None,
        noise_hz=np.count_nonzero(~hot) * US_PER_S / quiet_us / usual if usual else 0.0,
        hot_px=hot_px,
    )


def hot_pixels_of(packets: Iterable[EventPacket]) -> NDArray[np.int64]:
    """Return ``(h, 2)`` columns and rows of the hot pixels of a recording, from its beginning.

    Args:
        packets: The recording; it is iterated twice.
    """
    begin_us = next((packet.t_start_us for packet in packets), 0)
    end_us = begin_us + HOT_PIXEL_US
    early = list(takewhile(lambda packet: packet.t_start_us < end_us, packets))
    return judge_events(EventPacket.concatenate(early)).hot_px if early else np.empty((0, 2), int)
