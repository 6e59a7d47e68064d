"""The tracker's own rests as the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.calibration.buffered_events import BufferedEvents
from spikingtac.markers.calibration.trial_tracking import with_tracked_reference
from stand_ins.swaying_discs import PERIOD_US, REST_PX, STEP, calibration, swaying_discs

PASSES_US = np.array([0, 500, 1_000]) * PERIOD_US
"""The markers of the stand-in pass their rests at these times."""
RESTS_US = np.column_stack([PASSES_US, PASSES_US + 4_000])
ASIDE_PX = np.array([0.8, 0.0])
"""The tracker starts from a map that is painted so far off, and half of it stays: no disc leaves
all of its pixels."""


@pytest.fixture(scope="module")
def events() -> BufferedEvents:
    return swaying_discs()


def beside() -> Calibration:
    known = calibration(STEP)
    return replace(known, reference_px=known.reference_px + ASIDE_PX)


def test_a_wrong_reference_comes_nearer(events: BufferedEvents) -> None:
    found = with_tracked_reference(events, beside(), RESTS_US)
    assert np.abs(found.reference_px - REST_PX).max() < 0.6 * ASIDE_PX[0]


def test_a_marker_that_was_not_measured_stays(events: BufferedEvents) -> None:
    measured = np.array([True, True, True, False])
    given = replace(beside(), marker_measured=measured)
    found = with_tracked_reference(events, given, RESTS_US)
    np.testing.assert_array_equal(found.reference_px[3], given.reference_px[3])
    assert np.abs(found.reference_px[:3] - REST_PX[:3]).max() < 0.6 * ASIDE_PX[0]


def test_nothing_changes_without_a_rest_after_a_contact(events: BufferedEvents) -> None:
    given = beside()
    assert with_tracked_reference(events, given, RESTS_US[:1]) is given
