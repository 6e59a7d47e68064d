"""A place in a RAW recording from which it can be read on as if all before had been read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Place:
    """Where a decoder stands between two chunks.

    Words of time carry but the lower part of it, addresses are told once for several events: words
    alone do not say what they mean. The decoder's state does.

    Attributes:
        part: Number of the file, for a recording in parts.
        byte: First byte that was not read.
        state: State of the decoder (:mod:`spikingtac.events.formats.evt.clock`).
        t_us: Time of the last event before it, us.
    """

    part: int
    byte: int
    state: tuple[int, ...]
    t_us: int
