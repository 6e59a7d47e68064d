"""Filters equal plain twins however the stream is cut; hot pixels are told from noise and rims."""

import itertools

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.events.filters import BackgroundActivityFilter, Transform
from spikingtac.events.hot_pixels import HotPixelFilter, find_hot_pixels, judge_events
from stand_ins.random_packets import packet_of, random_packet, rows

SIZE = (12, 9)


@pytest.mark.parametrize("seed", range(4))
def test_background_activity_equals_its_twin_however_it_is_cut(seed: int) -> None:
    whole = random_packet(seed, 400, SIZE)
    edges = [0, *np.sort(np.random.default_rng(seed).integers(0, 400, 3 * seed)).tolist(), 400]
    parts = [whole.part(a, b, 0, whole.t_end_us) for a, b in itertools.pairwise(edges)]
    seen: dict[tuple[int, int], int] = {}
    expected = []
    for t, x, y, p in rows(whole):
        near = [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        if any(t - seen[place] <= 25 for place in near if place in seen):
            expected.append((t, x, y, p))
        seen[x, y] = t
    activity = BackgroundActivityFilter(SIZE, window_us=25)
    assert rows(*(activity(part) for part in parts)) == expected
    assert 0 < len(expected) < 400


def test_the_part_that_is_kept_is_half_open() -> None:
    whole = random_packet(4, 200, SIZE)
    inside = list(Transform(from_us=50, to_us=200).packets([whole]))
    assert rows(*inside) == [row for row in rows(whole) if 50 <= row[0] < 200]
    assert (inside[0].t_start_us, inside[-1].t_end_us) == (50, 200)
    assert rows(*Transform().packets([whole])) == rows(whole)
    assert list(Transform(to_us=0).packets([whole])) == []
    with pytest.raises(ConfigError, match="empty"):
        list(Transform(from_us=5, to_us=5).packets([whole]))


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


HOT_SIZE = (40, 30)


def noise(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, HOT_SIZE[0] * HOT_SIZE[1], count)


def at(column: int, row: int, count: int) -> np.ndarray:
    return np.full(count, row * HOT_SIZE[0] + column)


def mixed(*parts: np.ndarray) -> np.ndarray:
    return np.random.default_rng(2).permutation(np.concatenate(parts))


def found(pixel: np.ndarray) -> set[tuple[int, int]]:
    return {(int(column), int(row)) for column, row in find_hot_pixels(pixel, HOT_SIZE)}


def test_hot_pixels_are_found_also_in_corners_and_side_by_side() -> None:
    hot = {(0, 0), (39, 29), (20, 10), (21, 10)}
    assert found(mixed(noise(600), *(at(*place, 60) for place in hot))) == hot


def test_a_rim_that_moves_in_the_quietest_windows_is_not_hot() -> None:
    rim = [at(column, row, 60) for column in range(15, 25) for row in (10, 11)]
    assert found(mixed(noise(600), *rim)) == set()


def test_a_pixel_that_flickers_while_a_marker_rests_is_not_hot() -> None:
    flickering = at(20, 10, 60)
    assert not found(np.concatenate([noise(300), mixed(noise(100), flickering), noise(400)]))
    assert found(mixed(noise(800), flickering)) == {(20, 10)}


@pytest.mark.parametrize("noise_hz", [5.0, 40.0])
def test_noise_and_hot_pixels_are_told_apart_beside_a_contact(noise_hz: float) -> None:
    rng, duration_us = np.random.default_rng(3), 4_000_000
    hot = [(5, 7), (39, 29), (20, 0)]
    noisy = noise(round(noise_hz * HOT_SIZE[0] * HOT_SIZE[1] * duration_us / 1e6))
    contact = rng.integers(0, HOT_SIZE[0] * HOT_SIZE[1], 400_000)
    pixel = np.concatenate([noisy, contact, *(at(*place, 4_000) for place in hot)])
    t = rng.integers(0, duration_us, len(pixel))
    t[len(noisy) : len(noisy) + len(contact)] //= 2
    order = np.argsort(t, kind="stable")
    y, x = np.divmod(pixel[order], HOT_SIZE[0])
    events = packet_of(t[order], x, y, rng.random(len(x)) < 0.25, HOT_SIZE, (0, duration_us))
    found = judge_events(events)
    assert sorted(map(tuple, found.hot_px.tolist())) == sorted(hot)
    # The quietest tenth of the windows is quieter than the mean by the choice.
    assert found.noise_hz == pytest.approx(noise_hz, rel=0.3)
    assert found.on_fraction == pytest.approx(0.25, abs=0.01)
    kept = HotPixelFilter(found.hot_px, HOT_SIZE).kept(events)
    assert judge_events(kept).hot_px.size == 0
    assert HotPixelFilter(found.hot_px, HOT_SIZE).kept(kept) is kept
