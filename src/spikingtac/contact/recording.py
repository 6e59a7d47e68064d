"""Contacts in recordings: which windows are quiet, and what a detector finds in the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import numpy as np

from spikingtac.contact.detector import ContactDetector, Window, count_of, packets_of
from spikingtac.contact.motion_detector import MotionDetector
from spikingtac.errors import RecordingError
from spikingtac.events.source import EventSource
from spikingtac.events.windows import windows
from spikingtac.types import Contact

WINDOW_US = 1_000
"""Raw events are counted in 1 ms (paper section V-B)."""
FIRST_WINDOWS = 300
"""The least stretch that a recording has to begin with before anything touches: 0.3 s."""
MOST_WINDOWS = 120_000
"""Two minutes tell as much about a vibration of 15 Hz as an hour."""
BLOCK_WINDOWS = 30
"""Half a period of the arm's vibration; what precedes a busy block by up to two is not quiet."""
CLEAR_SIGMA = 5.0
""":func:`leading_quiet` ends at a block so many standard deviations above the first ones."""
DETAIL_WINDOWS = 20
"""A contact is described from what follows within 20 ms: one window may hold a dozen events."""


def paired_windows(sources: Sequence[EventSource]) -> Iterator[Window]:
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
    for window in zip(*streams, strict=False):
        if window[0].t_end_us - window[0].t_start_us == WINDOW_US:
            yield window


def leading_quiet(sources: Sequence[EventSource]) -> int:
    """Return how many of the first windows can be taken for quiet.

    The stretch ends where a block of windows holds clearly more events than those of the first
    0.3 s: a light contact that no single window shows.

    Raises:
        RecordingError: The recording is shorter than the least stretch, or holds no events.
    """
    stream = paired_windows(sources)
    first = np.array([count_of(window) for window in islice(stream, FIRST_WINDOWS)])
    if len(first) < FIRST_WINDOWS:
        raise RecordingError(
            f"the recording lasts {len(first)} ms; it has to begin with at least "
            f"{FIRST_WINDOWS} ms without contact, or give another one with --quiet"
        )
    blocks = first.reshape(-1, BLOCK_WINDOWS).sum(axis=1)
    spread = max(float(blocks.std(ddof=1)), float(np.sqrt(BLOCK_WINDOWS * first.var(ddof=1))))
    limit = float(blocks.mean()) + CLEAR_SIGMA * max(spread, 1.0)
    length = FIRST_WINDOWS
    while length < MOST_WINDOWS:
        block = [count_of(window) for window in islice(stream, BLOCK_WINDOWS)]
        if sum(block) > limit:
            return max(length - 2 * BLOCK_WINDOWS, FIRST_WINDOWS)
        length += len(block)
        if len(block) < BLOCK_WINDOWS:
            break
    return length


@dataclass(frozen=True, slots=True)
class FoundContact:
    """A contact of a recording.

    Attributes:
        contact: The decision.
        end_us: When the detector saw it end, or None where it lasts to the end of the recording.
        details: When it began and where; empty for a detector that does not know.
    """

    contact: Contact
    end_us: int | None
    details: dict[str, Any]


def find_contacts(
    sources: Sequence[EventSource], detector: ContactDetector
) -> Iterator[FoundContact]:
    """Yield each contact once it has ended, or the recording has."""
    found: Contact | None = None
    details: dict[str, Any] = {}
    age = 0
    for window in paired_windows(sources):
        begun = detector.update(window)
        if found is not None and (begun is not None or not detector.in_contact):
            yield FoundContact(found, packets_of(window)[0].t_end_us, details)
            found = None
        if begun is not None:
            found, details, age = begun, {}, 0
        age += 1
        if found is not None and age == DETAIL_WINDOWS:
            details = _details(detector)
    if found is not None:
        yield FoundContact(found, None, details or _details(detector))


def _details(detector: ContactDetector) -> dict[str, Any]:
    if not (isinstance(detector, MotionDetector) and detector.in_contact):
        return {}
    known = detector.details()
    touches = [
        None
        if touch is None
        else {
            "place_px": [round(value, 1) for value in touch.place_px],
            "push": [round(value, 3) for value in touch.push],
            "turn": round(touch.turn, 3),
            "markers": touch.markers,
        }
        for touch in known.touches
    ]
    return {"onset_us": known.onset_us, "sensors": touches}
