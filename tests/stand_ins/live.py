"""A source and a tracker that are simple enough to know the right answer of."""

from collections.abc import Callable

import numpy as np

from spikingtac.contact.detector import DetectorSummary, Window, count_of, packets_of
from spikingtac.events.source import PacketSource
from spikingtac.types import Contact, EventPacket, MarkerFrame
from stand_ins.random_packets import packet_of

SIZE = (32, 24)


def random_packets(seed: int, packets: int) -> list[EventPacket]:
    rng = np.random.default_rng(seed)
    made = []
    for start_us in range(5_000, 5_000 + packets * 10_000, 10_000):
        n, span_us = int(rng.integers(0, 40)), (start_us, start_us + 10_000)
        x, y, p = (rng.integers(0, below, n) for below in (*SIZE, 2))
        made.append(packet_of(np.sort(rng.integers(*span_us, n)), x, y, p, SIZE, span_us))
    return made


def random_source(seed: int, packets: int) -> PacketSource:
    return PacketSource(random_packets(seed, packets), SIZE)


def frame_of(t_us: int, rest_px: np.ndarray, moved_px: np.ndarray) -> MarkerFrame:
    """Return a frame of markers that are all seen."""
    place_px, held = rest_px + moved_px, np.zeros(len(rest_px), np.bool_)
    return MarkerFrame(t_us, place_px, place_px, moved_px, held, np.ones(len(rest_px)))


class MovedBy:
    """A tracker that looks at no event: its markers move by a function of time, us, or rest."""

    def __init__(
        self, rest_px: np.ndarray, moved_px: Callable[[int], np.ndarray] | None = None
    ) -> None:
        self._rest_px = rest_px
        self._moved_px = moved_px or (lambda t_us: np.zeros_like(rest_px))

    def absorb(self, packet: EventPacket) -> None: ...

    def estimate(self, t_us: int) -> MarkerFrame:
        return frame_of(t_us, self._rest_px, self._moved_px(t_us))

    def reset(self) -> None: ...


class CountingTracker:
    """Its one marker stands at (events seen, sum of their columns): any loss or repeat shows."""

    def __init__(self) -> None:
        self.reset()

    def absorb(self, packet: EventPacket) -> None:
        self.seen += len(packet)
        self.total += int(packet.x.sum())

    def estimate(self, t_us: int) -> MarkerFrame:
        position = np.array([[self.seen, self.total]], np.float64)
        return frame_of(t_us, np.zeros((1, 2)), position)

    def reset(self) -> None:
        self.seen = 0
        self.total = 0


class BurstDetector:
    """Reports windows with more than five events."""

    in_contact = False

    def update(self, window: Window) -> Contact | None:
        count = count_of(window)
        return Contact(packets_of(window)[0].t_end_us, count, 5) if count > 5 else None

    def reset(self) -> None:
        """It keeps nothing."""

    def summary(self) -> DetectorSummary:
        return DetectorSummary(rule="a contact is more than 5 events in a window")
