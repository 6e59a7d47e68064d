"""Degradation of events: added background and dropped events.

Training and the ``denoise`` experiment degrade events, never maps, so that the effect of noise on a
map is that of the state map itself.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from spikingtac.types import EventPacket

US_PER_S = 1e6
"""Microseconds in a second."""


def with_background(packet: EventPacket, rate_hz: float, random: Generator) -> EventPacket:
    """Add background activity: Poisson in time, uniform over pixels, random polarity.

    Args:
        packet: Events of a stretch of time.
        rate_hz: Events per second and pixel; 0 returns the packet itself.
        random: Source of the noise.

    Returns:
        Events and noise in order of time. An event precedes noise of the same time.
    """
    width, height = packet.size
    span_us = packet.t_end_us - packet.t_start_us
    count = int(random.poisson(rate_hz * width * height * span_us / US_PER_S)) if rate_hz else 0
    if count == 0:
        return packet
    t = np.concatenate([packet.t, random.integers(packet.t_start_us, packet.t_end_us, count)])
    order = np.argsort(t, kind="stable")
    x = np.concatenate([packet.x, random.integers(0, width, count, np.uint16)])
    y = np.concatenate([packet.y, random.integers(0, height, count, np.uint16)])
    p = np.concatenate([packet.p, random.random(count) < 0.5])
    return EventPacket(
        x[order], y[order], p[order], t[order], packet.t_start_us, packet.t_end_us, packet.size
    )


def with_drops(packet: EventPacket, fraction: float, random: Generator) -> EventPacket:
    """Drop each event with probability ``fraction``, 0 to 1."""
    return packet.select(random.random(len(packet)) >= fraction) if fraction else packet
