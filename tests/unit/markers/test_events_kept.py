from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.events_kept import EventsKept
from spikingtac.types import Calibration

STEP = 1.0 / 7.0
"""Seven steps per swing: six events and the dead band."""
CALIBRATION = Calibration(
    reference_px=np.zeros((10, 2)),
    radius_px=np.full(10, 7.0),
    grid=(1, 10),
    size=(320, 320),
    step_on=STEP,
    step_off=STEP,
)
EVENTS_PER_PX = 10 * 4 * 7.0 * 6.0
BACKGROUND_PER_MS = 20
SPEED_PX_S = 200.0


def last_share(kept: float, seconds: float = 3.0) -> float | None:
    """Move all markers to and fro and lose events; return the last share that was reported."""
    watch = EventsKept(CALIBRATION)
    still, moving = np.zeros((10, 2)), np.tile([SPEED_PX_S, 0.0], (10, 1))
    for _ in range(500):
        assert watch.update(int(BACKGROUND_PER_MS * kept), still, 1e-3) is None
    reported = None
    for _ in range(int(seconds * 1e3)):
        signal = EVENTS_PER_PX * SPEED_PX_S * 1e-3
        share = watch.update(int((signal + BACKGROUND_PER_MS) * kept), moving, 1e-3)
        reported = reported if share is None else share
    return reported


def test_a_whole_stream_changes_nothing() -> None:
    assert last_share(1.0) is None


@pytest.mark.parametrize("kept", [0.8, 0.7, 0.5, 0.3])
def test_the_share_that_arrives_is_found(kept: float) -> None:
    assert last_share(kept) == pytest.approx(kept, abs=0.04)


def test_texture_that_adds_events_is_not_loss() -> None:
    assert last_share(1.6) is None


def test_silence_and_standing_still_say_nothing() -> None:
    watch = EventsKept(CALIBRATION)
    for _ in range(5_000):
        assert watch.update(0, np.zeros((10, 2)), 1e-3) is None
    assert watch.update(100, np.full((10, 2), 300.0), 0.0) is None
