"""Windows of a camera with the times of their arrival, for the contact path."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from spikingtac.contact.window import Window
from spikingtac.events.open import open_events
from spikingtac.events.windows import windows
from spikingtac.live.contact_loop import Arrival
from spikingtac.types import LossCounters

SILENCE_US = 500_000
"""Longest silence that is filled with windows, us (ours: the watchdog stops the arm far sooner, and
the empty windows of a leap would only delay the ones after it)."""


def stream_arrivals(path: str | Path, period_us: int = 1_000) -> Iterator[Arrival]:
    """Yield the regular windows of a camera's pipe as they become complete.

    A :class:`~spikingtac.live.contact_process.ContactProcess` takes it as
    ``Factory(function=stream_arrivals, arguments={"path": ...})``; the pipe is then opened in the
    process that guards.
    A window is complete when an event after its end has come, which the sensor's noise ensures. To
    the watchdog, a camera that is wholly silent is a stalled stream.

    Args:
        path: Named pipe, or anything that :func:`~spikingtac.events.open.open_events` reads.
        period_us: Length of a window, us.

    Raises:
        RecordingError: The stream cannot be read; FormatError where it is not RAW.
    """
    source = open_events(path)
    regular = windows(source, period_us, silence_limit_us=SILENCE_US)
    return timed(((window,) for window in regular), source.losses)


def timed(stream: Iterable[Window], losses: LossCounters | None = None) -> Iterator[Arrival]:
    """Yield windows with the time at which they came.

    Args:
        stream: The windows.
        losses: Counters of the source, for the leaps of its clock; None knows of none.
    """
    counted = LossCounters() if losses is None else losses
    for window in stream:
        yield Arrival(window, time.monotonic(), counted["time_jump"])
