"""Read a file as its users do, and say what broke the promises of a source."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from spikingtac.errors import SpikingTacError
from spikingtac.events import open_events
from spikingtac.events.windows import windows

WINDOW_US = 10_000
MOST_WINDOWS = 1_000_000  # Windows that are looked at: damaged times may claim days of silences.


def outcome(path: Path) -> str:
    """Return ``read`` or ``refused`` for a file; anything else that happens is an error.

    Raises:
        AssertionError: A packet breaks what packets promise.
        Exception: Whatever else the reader raised that is no error of this package.
    """
    try:
        source = open_events(path)
        end_us = None
        for packet in source:
            assert end_us in (None, packet.t_start_us), "spans with gaps"
            end_us = packet.t_end_us
            assert len(packet.x) == len(packet.y) == len(packet.p) == len(packet.t)
            if len(packet):
                assert packet.t[0] >= packet.t_start_us, "an event before its packet"
                assert packet.t[-1] < packet.t_end_us, "an event after its packet"
                assert (np.diff(packet.t) >= 0).all(), "time goes back"
                assert packet.x.max() < source.size[0], "a column beyond the sensor"
                assert packet.y.max() < source.size[1], "a row beyond the sensor"
        for _ in islice(windows(source, WINDOW_US), MOST_WINDOWS):
            pass
    except SpikingTacError as error:
        return "refused" if str(error) else "an error without words"
    return "read"
