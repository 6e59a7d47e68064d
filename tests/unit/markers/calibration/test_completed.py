"""What a calibration by hand does not say is learned from the beginning of a recording."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.calibrate import completed
from spikingtac.types import EventPacket
from stand_ins.known import known
from stand_ins.random_packets import decoded
from stand_ins.rare_off import RADIUS_PX, SIZE, fired, levels

REST_PX = np.array([[24.0, 20.0], [60.0, 20.0], [24.0, 46.0], [60.0, 46.0]])
STEP, PERIOD_US, SAMPLES = 0.12, 1_000, 1_500
TOLD = replace(known(REST_PX, RADIUS_PX, SIZE, step=STEP), px_per_mm=9.0)
BY_HAND = replace(TOLD, grid=None, step_on=None, step_off=None, lag_us=None)


def swaying_discs() -> PacketSource:
    """Return the events of ideal pixels with equal thresholds."""
    phase = np.linspace(0.0, 6.0 * np.pi, SAMPLES)
    ways_px = np.column_stack([8.0 * np.sin(phase), 5.0 * np.sin(0.5 * phase)])
    maps = (levels(REST_PX + way_px, DiscProfile(4.0, 0.7)) for way_px in ways_px)
    sample, pixel, rises = fired(maps, STEP, STEP)
    whole = decoded(2 * pixel + rises, sample * PERIOD_US, SIZE, SAMPLES * PERIOD_US)
    return PacketSource([whole], SIZE)


def test_steps_are_learned_and_places_stay() -> None:
    found = completed(swaying_discs(), BY_HAND)
    assert [found.step_on, found.step_off] == pytest.approx([STEP, STEP], rel=0.15)
    np.testing.assert_array_equal(found.reference_px, REST_PX)
    assert (found.grid, found.px_per_mm) == (None, 9.0)


@pytest.mark.parametrize("known", [TOLD, BY_HAND])
def test_what_teaches_nothing_leaves_it_as_it_is(known) -> None:
    still = PacketSource([EventPacket.empty(0, 1_000, SIZE)], SIZE)
    assert completed(still, known) is known
