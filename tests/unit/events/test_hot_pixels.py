"""Hot pixels are told from noise, from rims that move, and from rims that flicker for a while."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.events.hot_pixels import (
    QUIET_SHARE,
    WINDOW_US,
    HotPixelFilter,
    find_hot_pixels,
    judge_events,
    quiet_events,
)
from spikingtac.types import EventPacket

SIZE = (40, 30)


def noise(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, SIZE[0] * SIZE[1], count)


def at(column: int, row: int, count: int) -> np.ndarray:
    return np.full(count, row * SIZE[0] + column)


def mixed(*parts: np.ndarray) -> np.ndarray:
    return np.random.default_rng(2).permutation(np.concatenate(parts))


def found(pixel: np.ndarray) -> set[tuple[int, int]]:
    return {(int(column), int(row)) for column, row in find_hot_pixels(pixel, SIZE)}


def test_hot_pixels_are_found_also_in_corners_and_side_by_side() -> None:
    hot = {(0, 0), (39, 29), (20, 10), (21, 10)}
    pixel = mixed(noise(600), *(at(*place, 60) for place in hot))
    assert found(pixel) == hot


def test_a_rim_that_moves_in_the_quietest_windows_is_not_hot() -> None:
    rim = [at(column, row, 60) for column in range(15, 25) for row in (10, 11)]
    assert found(mixed(noise(600), *rim)) == set()


def test_a_pixel_that_flickers_while_a_marker_rests_is_not_hot() -> None:
    flickering = at(20, 10, 60)
    pixel = np.concatenate([noise(300), mixed(noise(100), flickering), noise(400)])
    assert found(pixel) == set()
    assert found(mixed(noise(800), flickering)) == {(20, 10)}


def test_quiet_events_are_those_of_the_windows_with_the_fewest() -> None:
    windows = 40
    counts = np.full(windows, 9)
    counts[[3, 17, 18, 30]] = (1, 2, 0, 3)
    t_us = np.concatenate(
        [1_000 + WINDOW_US * window + np.arange(count) for window, count in enumerate(counts)]
    )
    index, quiet_us = quiet_events(t_us, 1_000, 1_000 + windows * WINDOW_US)
    assert quiet_us == round(QUIET_SHARE * windows) * WINDOW_US
    assert sorted(set(((t_us[index] - 1_000) // WINDOW_US).tolist())) == [3, 17, 30]
    assert (np.diff(index) > 0).all()
    assert len(index) == 6


@pytest.mark.parametrize("noise_hz", [5.0, 40.0])
def test_noise_and_hot_pixels_are_told_apart_beside_a_contact(noise_hz: float) -> None:
    rng, duration_us = np.random.default_rng(3), 4_000_000
    hot = [(5, 7), (39, 29), (20, 0)]
    noisy = noise(round(noise_hz * SIZE[0] * SIZE[1] * duration_us / 1e6))
    contact = rng.integers(0, SIZE[0] * SIZE[1], 400_000)
    pixel = np.concatenate([noisy, contact, *(at(*place, 4_000) for place in hot)])
    t = rng.integers(0, duration_us, len(pixel))
    t[len(noisy) : len(noisy) + len(contact)] //= 2
    order = np.argsort(t, kind="stable")
    y, x = (column.astype(np.uint16) for column in np.divmod(pixel[order], SIZE[0]))
    events = EventPacket(x, y, rng.random(len(x)) < 0.25, t[order], 0, duration_us, SIZE)
    found = judge_events(events)
    assert sorted(map(tuple, found.hot_px.tolist())) == sorted(hot)
    # The quietest tenth of the windows is quieter than the mean by the choice.
    assert found.noise_hz == pytest.approx(noise_hz, rel=0.3)
    assert found.on_fraction == pytest.approx(0.25, abs=0.01)
    kept = HotPixelFilter(found.hot_px, SIZE).kept(events)
    assert judge_events(kept).hot_px.size == 0
    assert HotPixelFilter(found.hot_px, SIZE).kept(kept) is kept
