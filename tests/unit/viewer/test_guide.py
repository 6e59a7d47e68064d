"""The guide over ideal slides: what has moved is known, which way, and what is lacking."""

import numpy as np
import pytest

from spikingtac.errors import CalibrationError
from spikingtac.types import EventPacket
from spikingtac.viewer.guide import CalibrationGuide, GuideView
from stand_ins.sliding import GRID, MARKERS, RADIUS_PX, SIZE, packets_of_trips, resting_px, trip


def seen(packets: list[EventPacket]) -> GuideView:
    guide = CalibrationGuide(SIZE)
    for packet in packets:
        guide.absorb(packet)
    return guide.view()


@pytest.fixture(scope="module")
def wide() -> list[EventPacket]:
    return packets_of_trips([trip((1, 0)), trip((-1, 0))])


def test_slides_by_more_than_a_diameter_are_enough(wide: list[EventPacket]) -> None:
    view = seen(wide)
    assert view.grid == GRID
    np.testing.assert_allclose(view.place_px, resting_px(), atol=1.0)
    assert abs(view.radius_px - RADIUS_PX) < 1.0
    assert view.enough.all()
    assert view.rests >= 3
    assert view.ready
    assert view.advice() == ["All 12 markers have moved enough: calibrate now."]
    assert "grid 3x4, 12 of 12 markers moved enough" in view.progress_line()


def test_any_packets_give_the_same(wide: list[EventPacket]) -> None:
    """But for when the guide looked: the maps depend on the events alone."""
    one, other = CalibrationGuide(SIZE), CalibrationGuide(SIZE)
    for packet in wide:
        one.absorb(packet)
        for half in packet.split((packet.t_start_us + packet.t_end_us) // 2):
            other.absorb(half)
    np.testing.assert_array_equal(one.level, other.level)


def test_what_went_left_only_by_a_little_has_to_go_right() -> None:
    # The left part of the skin has moved to both sides, the right column only to the left.
    moved = np.where(np.arange(MARKERS) % GRID[1] >= 3, 0.2, 1.0)
    view = seen(packets_of_trips([trip((-1, 0), moved), trip((1, 0), np.where(moved < 1, 0.0, 1))]))
    assert view.grid == GRID
    lacking = np.flatnonzero(~view.enough)
    assert set(lacking) == set(np.flatnonzero(moved < 1))
    assert set(view.sides[lacking].argmin(axis=1)) == {1}, "all have to go right"
    said = view.advice()[0]
    assert said.startswith("3 markers need more motion: slide right and back left")
    assert "right" in said.split("on the")[1]
    assert not view.ready


def test_noise_alone_is_no_grid() -> None:
    quiet = seen(packets_of_trips([trip((1, 0), 0.0)] * 3, noise_hz=1.0))
    assert quiet.grid is None
    assert quiet.advice()[0].startswith("Slide a flat object or a finger over all")
    assert not quiet.ready


def test_a_leap_of_years_is_refused_instead_of_counted_bin_by_bin() -> None:
    later = packets_of_trips([trip((1, 0), 0.0)], noise_hz=1.0)[0]
    with pytest.raises(CalibrationError, match="71 minutes"):
        seen([later, EventPacket.empty(1 << 58, (1 << 58) + 1, SIZE)])
