"""Where a marker always is, and where the ground is, from what the events around tell."""

import numpy as np
import pytest

from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration import level_maps as module
from spikingtac.markers.calibration.find_markers import clutter
from spikingtac.markers.calibration.level_maps import starting_levels
from spikingtac.markers.calibration.recording import buffer_events
from spikingtac.types import EventPacket
from stand_ins.ideal_events import ideal_events

SIZE, STEPS = (80, 60), np.full(2, 0.15, np.float32)
CENTER, RADIUS_PX = (40.0, 30.0), 14.0
WAYS = ((1, 0), (-1, 0), (0, 1), (0, -1))


def discs_moved(amplitude_px: float, centers: list[tuple[float, float]]) -> EventPacket:
    """Return the events of discs that go to and fro in four directions."""
    trip = amplitude_px * np.sin(np.linspace(0, np.pi, 24)) ** 2
    path = np.concatenate([trip[:, np.newaxis] * np.array(way) for way in WAYS])
    moving = np.array(centers) + path[:, np.newaxis]
    packet = ideal_events(moving, RADIUS_PX, SIZE, 4_000)
    return buffer_events(PacketSource([packet], SIZE))


def away_px() -> np.ndarray:
    """Return the distance of each pixel from the disc's middle."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    return np.hypot(x - CENTER[0], y - CENTER[1])


def starts(events: EventPacket) -> np.ndarray:
    return starting_levels(events, np.empty((0, 2), np.int64), STEPS) > 0.5


@pytest.mark.parametrize("amplitude_px", [3.0, 6.0])
def test_what_a_disc_never_leaves_is_covered(amplitude_px: float) -> None:
    covered = starts(discs_moved(amplitude_px, [CENTER]))
    assert covered[away_px() < RADIUS_PX - amplitude_px - 3.0].all()
    assert not covered[away_px() > RADIUS_PX + 1.0].any()


def test_ground_that_discs_enclose_is_no_marker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four discs close in on ground that none of them reaches: all around it brightens."""
    around = [(CENTER[0] + 23.5 * x, CENTER[1] + 23.5 * y) for x, y in WAYS]
    events, middle = discs_moved(6.0, around), away_px() < 1.0
    assert not starts(events)[middle].any()
    monkeypatch.setattr(module, "LEAST_LIT", -1.0)
    assert starts(events)[middle].all(), "it is enclosed, and only its rim tells it from a marker"


def test_a_disc_is_less_clutter_than_a_smaller_ring_around_it() -> None:
    assert clutter(1.0 * (away_px() < 14.0)) < clutter(1.0 * (np.abs(away_px() - 16.0) < 1.8))
