"""Windows of events, the quiet ones at the beginning of a recording, and its contacts.

Contacts in recordings: find the quiet windows, and run a detector over the rest.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import (
    BLOCK_WINDOWS,
    CLEAR_SIGMA,
    WINDOW_US,
    ContactDetector,
    Window,
    count_of,
    packets_of,
    unsettled,
)
from spikingtac.errors import RecordingError
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.types import Contact, EventPacket

# A recording has to begin with at least this stretch without contact: 0.3 s.
LEAST_QUIET_WINDOWS = 300
MOST_WINDOWS = 120_000  # Two minutes tell as much about a vibration of 15 Hz as an hour.
BURST_WINDOWS = 50  # Longer than batches of cameras (10 ms); most of a period at 15 Hz.
MOST_UNSETTLED = 2000  # Most windows at the beginning that are passed over, 2 s.


def paired_windows(sources: Sequence[Iterable[EventPacket]]) -> Iterator[Window]:
    """Yield the 1 ms windows of one or two sensors on one clock, as long as all of them last.

    Raises:
        RecordingError: A source holds nothing.
    """
    packets = [iter(source) for source in sources]
    first = [packet for stream in packets if (packet := next(stream, None)) is not None]
    if len(first) < len(sources):
        raise RecordingError("the recording holds no events; check the file and the camera")
    origin_us = max(packet.t_start_us for packet in first)
    streams = [
        windows(chain([begun], others), WINDOW_US, origin_us)
        for begun, others in zip(first, packets, strict=True)
    ]
    for window in _aligned(streams):
        if all(packet.t_end_us - packet.t_start_us == WINDOW_US for packet in window):
            yield window


def _aligned(streams: Sequence[Iterator[EventPacket]]) -> Iterator[tuple[EventPacket, ...]]:
    """Pair windows by time: a sensor whose long silence was not filled gets empty ones."""
    heads = [next(stream, None) for stream in streams]
    while all(head is not None for head in heads):
        known = [head for head in heads if head is not None]
        first = min(known, key=lambda head: head.t_start_us)
        start_us, end_us = first.t_start_us, first.t_end_us
        yield tuple(
            head if head.t_start_us == start_us else EventPacket.empty(start_us, end_us, head.size)
            for head in known
        )
        heads = [
            next(stream, None) if head.t_start_us == start_us else head
            for stream, head in zip(streams, known, strict=True)
        ]


def leading_quiet(sources: Sequence[EventSource]) -> tuple[int, int]:
    """Return the first and the last (exclusive) of the leading windows that count as quiet.

    The stretch begins once the camera has settled. It ends where a block of windows holds clearly
    more events than the blocks of its first 0.3 s, or more of the rarer polarity: a motion fires
    both, the light and the leak one. The two blocks before a busy one do not count. A block shows a
    light contact that no single window shows.

    Raises:
        RecordingError: The recording is shorter than the least stretch, or holds no events.
    """
    stream = paired_windows(sources)
    first, begin = _polarities(islice(stream, LEAST_QUIET_WINDOWS)), 0
    while (
        begin <= MOST_UNSETTLED
        and len(first) == LEAST_QUIET_WINDOWS
        and (skipped := unsettled(first.sum(axis=1)))
    ):
        begin += skipped
        first = np.append(first[skipped:], _polarities(islice(stream, skipped)), axis=0)
    if len(first) < LEAST_QUIET_WINDOWS:
        raise RecordingError(
            f"the recording lasts {begin + len(first)} ms; it has to begin with at least "
            f"{LEAST_QUIET_WINDOWS} ms without contact, or give another one with --quiet"
        )
    blocks = _all_and_rarer(first.reshape(-1, BLOCK_WINDOWS, 2).sum(axis=1))
    by_window = np.sqrt(BLOCK_WINDOWS * _all_and_rarer(first.var(axis=0, ddof=1)))
    spread = np.maximum(blocks.std(axis=0, ddof=1), by_window)
    limit = blocks.mean(axis=0) + CLEAR_SIGMA * np.maximum(spread, 1.0)
    length = LEAST_QUIET_WINDOWS
    while length < MOST_WINDOWS and len(block := _polarities(islice(stream, BLOCK_WINDOWS))):
        if (_all_and_rarer(block.sum(axis=0)) > limit).any():
            return begin, begin + max(length - 2 * BLOCK_WINDOWS, LEAST_QUIET_WINDOWS)
        length += len(block)
    return begin, begin + length


def _polarities(stream: Iterable[Window]) -> NDArray[np.int64]:
    """Return ``(n, 2)`` the OFF and the ON events of each window, over all sensors."""
    counts = [sum(np.bincount(one.p, minlength=2) for one in packets_of(w)) for w in stream]
    return np.reshape(np.array(counts, np.int64), (-1, 2))


def _all_and_rarer(counts: NDArray[Any]) -> NDArray[Any]:
    """Return ``(..., 2)``: of OFF and ON counts their sum and the smaller one."""
    return np.stack([counts.sum(axis=-1), counts.min(axis=-1)], axis=-1)


def come_in_bursts(counts: Sequence[int]) -> bool:
    """Return whether windows that pass for quiet hold motion: few of them have most events.

    Counts of blocks then vary by more than their mean, beyond a Poisson distribution. (At most 0.3
    of the mean on seven recordings with a quiet beginning, 1.7 on one that begins with a press.)
    """
    blocks = len(counts) // BURST_WINDOWS
    events = np.reshape(counts[: blocks * BURST_WINDOWS], (blocks, BURST_WINDOWS)).sum(axis=1)
    return bool(events.var() - events.mean() > events.mean() ** 2)


def quietest(sources: Sequence[EventSource]) -> tuple[int, int]:
    """Return the first and the last (exclusive) of the 300 windows with the fewest events.

    For recordings that begin in contact, as those of a sensor without noise do. At least one event
    is among them, since a dead camera teaches nothing.
    """
    stream = islice(paired_windows(sources), MOST_WINDOWS)
    sums = np.cumsum([0, *map(count_of, stream)])
    counts = sums[LEAST_QUIET_WINDOWS:] - sums[:-LEAST_QUIET_WINDOWS]
    begin = int(np.where(counts > 0, counts, sums[-1] + 1).argmin())
    return begin, begin + LEAST_QUIET_WINDOWS


def find_contacts(
    sources: Sequence[EventSource],
    detector: ContactDetector,
    stream: Iterator[Window] | None = None,
    first: int = 0,
) -> Iterator[tuple[Contact, int | None]]:
    """Yield each contact with its end, us, once it has ended; None where the recording ends first.

    Args:
        sources: One or two sensors on one clock.
        detector: Decides.
        stream: Their windows, as of :func:`~spikingtac.stream.pair.live_windows` for cameras;
            None reads them.
        first: The first window that counts; a camera may begin with a burst.
    """
    found: Contact | None = None
    for window in islice(stream or paired_windows(sources), first, None):
        begun = detector.update(window)
        if found is not None and (begun is not None or not detector.in_contact):
            yield found, packets_of(window)[0].t_end_us
            found = None
        found = begun or found
    if found is not None:
        yield found, None
