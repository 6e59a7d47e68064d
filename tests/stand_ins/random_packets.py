"""Events drawn at random, and what sources give of them."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.events import EventSource, create_events
from spikingtac.events.formats.codec import Triggers
from spikingtac.types import EventPacket

Rows = list[tuple[int, int, int, bool]]


def packet_of(
    t: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    p: np.ndarray,
    size: tuple[int, int],
    span_us: tuple[int, int] | None = None,
) -> EventPacket:
    """Return a packet over a span, or from its first event to its last."""
    x, y = x.astype(np.uint16), y.astype(np.uint16)
    span_us = span_us or ((int(t[0]), int(t[-1]) + 1) if len(t) else (0, 0))
    return EventPacket(x, y, p.astype(np.bool_), t.astype(np.int64), *span_us, size)


def decoded(code: np.ndarray, t: np.ndarray, size: tuple[int, int], end_us: int) -> EventPacket:
    """Return events from 0 us on whose codes are their pixel's number times 2, plus 1 for ON."""
    y, x = np.divmod(code >> 1, size[0])
    return packet_of(t, x, y, code & 1, size, (0, end_us))


def packet_at(times_us: Any, span_us: tuple[int, int], size: tuple[int, int]) -> EventPacket:
    """Return events of the first pixel, OFF, at these times."""
    t = np.array(times_us, np.int64)
    return packet_of(t, 0 * t, 0 * t, t < 0, size, span_us)


def random_packet(
    seed: int, n: int, size: tuple[int, int], steps_us: int = 9, first_us: int = 0
) -> EventPacket:
    """Return events evenly over the sensor, in steps below ``steps_us``."""
    rng = np.random.default_rng(seed)
    t = first_us + np.cumsum(rng.integers(0, steps_us, n))
    x, y = (rng.integers(0, side, n) for side in size)
    return packet_of(t, x, y, rng.random(n) < 0.5, size)


def cut_at(packet: EventPacket, edges_us: Sequence[int]) -> list[EventPacket]:
    """Return the parts of a packet between times, each over the span between two of them."""
    index = np.searchsorted(packet.t, edges_us).tolist()
    spans = zip(index, index[1:], edges_us, edges_us[1:], strict=False)
    return [packet.part(*span) for span in spans]


def save_events(
    path: Path,
    *packets: EventPacket,
    encoding: str | None = None,
    triggers: Triggers | None = None,
) -> Path:
    """Write packets as a file of the format that its name tells, and return its path."""
    with create_events(path, packets[0].size, encoding=encoding) as writer:
        writer.add_triggers(triggers or Triggers())
        for packet in packets:
            writer.write(packet)
    return path


def whole(source: EventSource) -> EventPacket:
    """Return all events of a source, whose packets must follow each other without gaps."""
    found = list(source)
    for packet in found:
        assert packet.t_start_us <= packet.t[0]
        assert packet.t[-1] < packet.t_end_us
    for before, after in itertools.pairwise(found):
        assert before.t_end_us == after.t_start_us
    return EventPacket.concatenate(found) if found else EventPacket.empty(0, 0, source.size)


def rows(*packets: EventPacket) -> Rows:
    """Return the events as (t, x, y, p)."""
    columns = ([getattr(packet, name).tolist() for name in "txyp"] for packet in packets)
    return [row for parts in columns for row in zip(*parts, strict=True)]


def assert_equal(found: EventPacket, expected: EventPacket) -> None:
    """Require equal columns of equal types."""
    for name in "txyp":
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert getattr(found, name).dtype == getattr(expected, name).dtype
