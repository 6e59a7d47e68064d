"""The kernels behind the calibration against plain loops, on random and edge events."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.markers.calibration.contrast_steps import (
    ContrastSteps,
    StepConfig,
    count_runs_kernel,
    learn_steps,
    sum_swings_kernel,
)
from spikingtac.markers.calibration.slide_map import SlideMap
from spikingtac.markers.calibration.slides import Slides

SIZE = (6, 4)
PIXELS = 24


def random_slides(count: int, seed: int) -> Slides:
    rng = np.random.default_rng(seed)
    code = rng.integers(0, 2 * PIXELS, count).astype(np.uint32)
    time_us = np.sort(rng.integers(0, 1000, count)).astype(np.uint32)
    return Slides(code, time_us, SIZE, 0, 1000)


def random_steps(seed: int) -> ContrastSteps:
    rng = np.random.default_rng(seed)
    on, off = rng.uniform(0.1, 0.3, (2, 4, 6)).astype(np.float32)
    return ContrastSteps(on, off, 0.2, 0.2, np.zeros((4, 6), np.int32))


def runs_of(slides: Slides) -> list[tuple[int, bool, int]]:
    out, open_runs = [], {}
    for value in slides.code.tolist():
        pixel, on = value >> 1, bool(value & 1)
        before_on, length = open_runs.get(pixel, (on, 0))
        if before_on == on:
            open_runs[pixel] = (on, length + 1)
        else:
            out.append((pixel, before_on, length))
            open_runs[pixel] = (on, 1)
    return out


@pytest.mark.parametrize("count", [0, 1, 2, 300, 3000])
def test_runs_equal_the_twin(count: int) -> None:
    slides = random_slides(count, count)
    histogram = np.zeros((2, 6), np.int64)
    count_runs_kernel(slides.code, np.zeros(PIXELS, np.int32), histogram)
    bounds = np.array([[2, 3], [1, 4]])
    total, swings = np.zeros((2, PIXELS), np.int32), np.zeros((2, PIXELS), np.int32)
    sum_swings_kernel(slides.code, np.zeros(PIXELS, np.int32), bounds, total, swings)
    expected = np.zeros_like(histogram), np.zeros_like(total), np.zeros_like(swings)
    for pixel, on, length in runs_of(slides):
        expected[0][int(on), min(length, 5)] += 1
        if bounds[int(on), 0] <= length <= bounds[int(on), 1]:
            expected[1][int(on), pixel] += length
            expected[2][int(on), pixel] += 1
    for got, wanted in zip((histogram, total, swings), expected, strict=True):
        np.testing.assert_array_equal(got, wanted)


def twin_map(slides: Slides, steps: ContrastSteps, index: int, backward: bool) -> np.ndarray:
    level = np.zeros(PIXELS)
    on, off = steps.on.ravel().astype(float), steps.off.ravel().astype(float)
    events = slides.code[index:][::-1] if backward else slides.code[:index]
    for value in events.tolist():
        pixel = value >> 1
        rises = bool(value & 1) != backward
        bounds = (on[pixel] / 2, 1 - off[pixel] / 2)
        change = on[pixel] if value & 1 else off[pixel]
        moved = level[pixel] + change if rises else level[pixel] - change
        level[pixel] = min(moved, bounds[1]) if rises else max(moved, bounds[0])
    side = np.zeros(PIXELS)
    for value in slides.code[:index].tolist():
        side[value >> 1] = 1 if value & 1 else -1
    if backward:  # pixels without any event to undo were never told a side
        touched = np.zeros(PIXELS, bool)
        touched[slides.code >> 1] = True
        side[~touched] = 0
    middle = level + np.where(side > 0, on / 2, np.where(side < 0, -off / 2, 0.0))
    return middle.clip(0, 1).reshape(4, 6)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("cuts", [(), (7,), (1, 2, 150, 290)])
def test_maps_equal_the_twin_however_they_are_moved(backward: bool, cuts: tuple[int, ...]) -> None:
    slides, steps = random_slides(300, 5), random_steps(6)
    slide_map = SlideMap(slides, steps, backward=backward)
    for index in sorted((*cuts, 0 if backward else 300), reverse=backward):
        slide_map.move_to(index)
        expected = twin_map(slides, steps, index, backward)
        np.testing.assert_allclose(slide_map.values, expected, atol=1e-5)


def test_forth_and_back_is_where_it_began_inside_of_the_ends() -> None:
    code = np.array([9, 9, 8, 9, 8, 8], np.uint32)
    slides = Slides(code, np.arange(6, dtype=np.uint32), SIZE, 0, 6)
    even = np.full((4, 6), 0.1, np.float32)
    steps = ContrastSteps(even, even, 0.1, 0.1, np.zeros((4, 6), np.int32))
    start = np.full((4, 6), 0.5, np.float32)
    forth = SlideMap(slides, steps, level=start)
    forth.move_to(6)
    back = SlideMap(slides, steps, backward=True, level=forth.level)
    back.move_to(0)
    np.testing.assert_allclose(back.values, start, atol=1e-6)


def swings_of(length: int, times: int) -> Slides:
    one = np.concatenate([np.ones(length), np.zeros(length)]).astype(np.uint32)
    code = np.concatenate([2 * pixel + np.tile(one, times) for pixel in range(PIXELS)])
    code = code.astype(np.uint32)
    return Slides(code, np.arange(len(code), dtype=np.uint32), SIZE, 0, len(code))


@pytest.mark.parametrize("length", [3, 6, 12])
def test_steps_follow_the_length_of_a_swing(length: int) -> None:
    steps = learn_steps(swings_of(length, 20), StepConfig())
    assert steps.mean_on == pytest.approx(1 / (length + 1))
    np.testing.assert_allclose(steps.on, 1 / (length + 1), rtol=1e-6)
    np.testing.assert_allclose(steps.off, 1 / (length + 1), rtol=1e-6)


def test_without_swings_the_nominal_step_holds() -> None:
    steps = learn_steps(random_slides(50, 1), StepConfig(nominal_step=0.2))
    assert steps.mean_on == 0.2
    np.testing.assert_allclose(steps.off, 0.2)
