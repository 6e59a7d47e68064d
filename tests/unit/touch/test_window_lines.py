"""The lines of all windows of a stream: however it is packed, and where its time leaps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from spikingtac.events.windows import SILENCE_LIMIT_US
from spikingtac.pipeline.follow import follow
from spikingtac.pipeline.shared_events import SharedEventsTracker
from spikingtac.touch.vibration.event_vibration import (
    EventVibrationConfig,
    EventVibrationMonitor,
)
from spikingtac.touch.vibration.rim_memory import BIN_US
from spikingtac.touch.vibration.window_lines import WindowLines
from spikingtac.types import EventPacket, MarkerFrame
from stand_ins.shaken_discs import CALIBRATION, CENTERS, SIZE, shaken_stream

SHORT = EventVibrationConfig(window_s=0.4, lowest_hz=20.0)


@pytest.fixture(scope="module")
def shaken() -> EventPacket:
    return shaken_stream(120.0, 0.8, 0.41)


class Shifted:
    """A tracker that sees all markers go 9 px to the right at a time, at once."""

    def __init__(self, at_us: int) -> None:
        self._at_us = at_us

    def absorb(self, packet: EventPacket) -> None:
        """Need no events."""

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return where the markers are."""
        away = np.tile([9.0 * (t_us >= self._at_us), 0.0], (len(CENTERS), 1))
        return MarkerFrame(
            t_us, CENTERS + away, CENTERS + away, away, np.zeros(4, bool), np.ones(4)
        )

    def reset(self) -> None:
        """Have nothing to forget."""


def packed(whole: EventPacket, length_us: int) -> Iterator[EventPacket]:
    for start_us in range(0, whole.t_end_us, length_us):
        end_us = min(start_us + length_us, whole.t_end_us)
        first, last = np.searchsorted(whole.t, [start_us, end_us])
        yield whole.part(int(first), int(last), start_us, end_us)


def test_every_window_of_a_stream_is_heard_however_it_is_packed(shaken: EventPacket) -> None:
    x, half_us = np.concatenate([shaken.x, shaken.x, shaken.x + 9]), 2 * shaken.t_end_us
    t = np.concatenate([shaken.t + k * shaken.t_end_us for k in range(3)])
    y, p = np.tile(shaken.y, 3), np.tile(shaken.p, 3)
    inside = x < SIZE[0]
    columns = (column[inside] for column in (x, y, p, t))
    whole = EventPacket(*columns, 0, 3 * shaken.t_end_us, SIZE)
    found = []
    for length_us in (whole.t_end_us, 1_000, 33_000, 70_000):
        heard = WindowLines(EventVibrationMonitor(CALIBRATION, SHORT))
        tracker = SharedEventsTracker(Shifted(half_us), heard.absorb)
        for frame in follow(packed(whole, length_us), tracker, 1_000.0):
            heard.monitor.follow(frame)
        found.append(heard.lines)
    ends_us = [int(whole.t[0]) + k * round(1e6 * SHORT.window_s) for k in (1, 2, 3)]
    for lines in found:
        assert [line.t_us for line in lines] == [end // BIN_US * BIN_US for end in ends_us]
        assert [round(line.hz) for line in lines] == [120, 120, 120]
        assert lines[0].amplitude_px == pytest.approx(0.8, rel=0.1)
        assert lines[2].amplitude_px == pytest.approx(0.8, rel=0.4)  # rims follow within 0.1 s
        for line, other in zip(lines, found[0], strict=True):
            assert (line.hz, line.ratio, line.amplitude_px) == pytest.approx(
                (other.hz, other.ratio, other.amplitude_px), rel=1e-9
            )


def test_a_leap_of_time_begins_the_windows_anew(shaken: EventPacket) -> None:
    heard = WindowLines(EventVibrationMonitor(CALIBRATION, SHORT))
    heard.absorb(shaken)
    heard.absorb(shaken)  # the recording is played again
    first_us = int(shaken.t[0]) + heard.monitor.window_us
    assert [line.t_us for line in heard.lines] == 2 * [first_us // BIN_US * BIN_US]


def leaping(shaken: EventPacket, leap_us: int) -> EventPacket:
    """Return the stream twice, with a silence in between."""
    x, y, p = (np.tile(column, 2) for column in (shaken.x, shaken.y, shaken.p))
    again_us = shaken.t_end_us + leap_us
    t = np.concatenate([shaken.t, shaken.t + again_us])
    return EventPacket(x, y, p, t, 0, again_us + shaken.t_end_us, SIZE)


@pytest.mark.parametrize("leap_us", [200_000, 60_100_000, 60_200_000, 70_000_000])
def test_the_windows_after_a_silence_do_not_depend_on_the_packing(
    shaken: EventPacket, leap_us: int
) -> None:
    whole = leaping(shaken, leap_us)
    spans = [part for part in packed(whole, 33_000) if len(part)]
    tight = [part.part(0, len(part), int(part.t[0]), int(part.t[-1]) + 1) for part in spans]
    found = []
    for packets in ([whole], spans, tight):
        heard = WindowLines(EventVibrationMonitor(CALIBRATION, SHORT))
        tracker = SharedEventsTracker(Shifted(10 * whole.t_end_us), heard.absorb)
        for frame in follow(packets, tracker, 1_000.0):
            heard.monitor.follow(frame)
        found.append([(line.t_us, line.hz, line.amplitude_px) for line in heard.lines])
    assert len(found[0]) == 2
    assert found[0] == found[1] == found[2]
    if leap_us > SILENCE_LIMIT_US:  # they begin anew at the first event after it
        ends_us = int(whole.t[len(shaken)]) + heard.monitor.window_us
        assert found[0][1][0] == ends_us // BIN_US * BIN_US
