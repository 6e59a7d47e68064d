"""Filters on events: stateful ones give the same events however the stream is cut into packets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spikingtac.errors import ConfigError
from spikingtac.types import EventPacket


@dataclass(frozen=True, kw_only=True)
class BackgroundActivityConfig:
    """Settings of the background-activity filter.

    Attributes:
        window_us: How long an event supports its neighbours (ours: an edge at 1 px/ms passes a
            neighbour within 1 ms; 5 ms leaves room for slow motion).
    """

    window_us: int = 5_000

    def __post_init__(self) -> None:
        if self.window_us < 1:
            raise ValueError(f"window_us is {self.window_us}, it must be at least 1")


class BackgroundActivityFilter:
    """Keeps events that one of the eight neighbours supports by an event shortly before.

    Source: T. Delbruck, "Frame-free dynamic digital vision", Intl. Symp. on Secure-Life
    Electronics, 2008 (the background activity filter).

    Args:
        config: Settings.
        size: ``(width, height)`` of the sensor, px.
    """

    def __init__(self, config: BackgroundActivityConfig, size: tuple[int, int]) -> None:
        self._window_us = config.window_us
        self._last_us = np.full((size[1] + 2, size[0] + 2), np.iinfo(np.int64).min // 2)

    def __call__(self, packet: EventPacket) -> EventPacket:
        """Return the supported events of a packet that follows the ones before.

        Raises:
            ConfigError: The packet comes from a sensor of another size, or leaves it.
        """
        from spikingtac.events.filter_kernels import supported_kernel

        height, width = self._last_us.shape
        packet.require_map((height - 2, width - 2))
        x, y = np.empty_like(packet.x), np.empty_like(packet.y)
        p, t = np.empty_like(packet.p), np.empty_like(packet.t)
        events = packet.x, packet.y, packet.p, packet.t
        count = supported_kernel(*events, self._window_us, self._last_us, (x, y, p, t))
        return EventPacket(
            x[:count],
            y[:count],
            p[:count],
            t[:count],
            packet.t_start_us,
            packet.t_end_us,
            packet.size,
            checked=True,
        )


class RandomDrop:
    """Drops each event with one and the same probability, for experiments.

    Args:
        share: Probability of a drop, 0 to 1.
        seed: Seed of the generator; the same events are dropped however the stream is cut.

    Raises:
        ConfigError: The share is not between 0 and 1.
    """

    def __init__(self, share: float, seed: int) -> None:
        if not 0 <= share <= 1:
            raise ConfigError(f"share is {share}, it must lie between 0 and 1")
        self._share = share
        self._random = np.random.default_rng(seed)

    def __call__(self, packet: EventPacket) -> EventPacket:
        """Return the events of a packet that stay."""
        return packet.select(self._random.random(len(packet)) >= self._share)
