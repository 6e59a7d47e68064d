"""Transforms of a recording: against plain arithmetic on single events."""

from __future__ import annotations

import pytest

from spikingtac.errors import ConfigError
from spikingtac.events import filters
from spikingtac.events.filters import Transform
from spikingtac.events.formats.codec import Triggers
from stand_ins.random_packets import random_packet, rows

SIZE = (12, 9)


def test_time_slice_is_half_open() -> None:
    whole = random_packet(4, 200, SIZE)
    inside = list(filters.time_slice([whole], 50, 200))
    assert rows(*inside) == [row for row in rows(whole) if 50 <= row[0] < 200]
    assert (inside[0].t_start_us, inside[-1].t_end_us) == (50, 200)
    assert rows(*filters.time_slice([whole])) == rows(whole)
    assert list(filters.time_slice([whole], to_us=0)) == []
    with pytest.raises(ConfigError, match="empty"):
        list(filters.time_slice([whole], 5, 5))


CASES = {
    "polarity": (Transform(flip_polarity=True), lambda t, x, y, p: (t, x, y, not p), SIZE),
    "shift": (Transform(shift_us=-70), lambda t, x, y, p: (t - 70, x, y, p), SIZE),
    "flip x": (Transform(flip="x"), lambda t, x, y, p: (t, 11 - x, y, p), SIZE),
    "flip y": (Transform(flip="y"), lambda t, x, y, p: (t, x, 8 - y, p), SIZE),
    "90": (Transform(rotate_deg=90), lambda t, x, y, p: (t, 8 - y, x, p), (9, 12)),
    "180": (Transform(rotate_deg=180), lambda t, x, y, p: (t, 11 - x, 8 - y, p), SIZE),
    "270": (Transform(rotate_deg=270), lambda t, x, y, p: (t, y, 11 - x, p), (9, 12)),
}


@pytest.mark.parametrize("name", CASES)
def test_every_event_goes_where_arithmetic_says(name: str) -> None:
    change, rule, size = CASES[name]
    whole = random_packet(1, 200, SIZE)
    expected = [rule(*row) for row in rows(whole)]
    for pieces in ([whole], list(whole.split(300))):
        changed = list(change.packets(pieces))
        assert rows(*changed) == expected
        assert {packet.size for packet in changed} == {size} == {change.size(SIZE)}
        for packet in changed:
            packet.sound()


def test_a_crop_keeps_its_rectangle_and_moves_the_origin() -> None:
    whole = random_packet(2, 200, SIZE)
    (cropped,) = Transform(crop_px=(2, 3, 10, 9)).packets([whole])
    kept = [(t, x - 2, y - 3, p) for t, x, y, p in rows(whole) if 2 <= x < 10 and 3 <= y < 9]
    assert rows(cropped) == kept
    assert (cropped.size, cropped.t_end_us) == ((8, 6), whole.t_end_us)
    for box in ((0, 0, 13, 9), (4, 0, 4, 9), (-1, 0, 4, 9)):
        with pytest.raises(ConfigError, match="sensor of 12x9"):
            Transform(crop_px=box).size(SIZE)


def test_triggers_follow_the_time() -> None:
    triggers = Triggers()
    triggers.append([5, 50, 199, 200], 3, [True, False, True, False])
    kept = Transform(from_us=50, to_us=200, shift_us=1_000).triggers(triggers)
    assert (kept.t_us.tolist(), kept.channel.tolist(), kept.edge.tolist()) == (
        [1_050, 1_199],
        [3, 3],
        [False, True],
    )
