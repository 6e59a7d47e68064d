"""What a calibration by hand does not say is learned from the beginning of a recording."""

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration.calibrate import completed
from spikingtac.types import EventPacket
from stand_ins.swaying_discs import REST_PX, STEP, calibration, swaying_discs


def by_hand() -> Calibration:
    known = calibration(STEP)
    return Calibration(
        reference_px=REST_PX, radius_px=known.radius_px, grid=None, size=known.size, px_per_mm=9.0
    )


def test_steps_are_learned_and_places_stay() -> None:
    found = completed(swaying_discs(), by_hand())
    assert found.step_on == pytest.approx(STEP, rel=0.15)
    assert found.step_off == pytest.approx(STEP, rel=0.15)
    np.testing.assert_array_equal(found.reference_px, REST_PX)
    assert found.grid is None
    assert found.px_per_mm == 9.0


def test_what_teaches_nothing_leaves_it_as_it_is() -> None:
    known = by_hand()
    still = PacketSource([EventPacket.empty(0, 1_000, known.size)], known.size)
    assert completed(still, known) is known
    told = calibration(STEP)
    assert completed(still, told) is told
