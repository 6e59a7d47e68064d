"""The kernels behind the calibration against plain loops, on random and edge events."""

from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.markers.calibration.disc_corrections import (
    RESIDUAL_LEVEL,
    common_sums_kernel,
    corrections,
    slopes_kernel,
    state_sums_kernel,
)
from spikingtac.markers.calibration.disc_fits import (
    claim_kernel,
    fit_kernel,
    fit_room,
    gather_kernel,
    sums_kernel,
)
from spikingtac.markers.calibration.disc_levels import (
    Course,
    Discs,
    PixelSteps,
    draw_kernel,
    nearest_markers,
    stretched_kernel,
)
from spikingtac.markers.calibration.expected_levels import (
    PHASES,
    Walk,
    walk,
)
from spikingtac.markers.calibration.following import (
    lead_kernel,
    move_kernel,
    note_polarity_kernel,
    pull_kernel,
)
from spikingtac.markers.calibration.level_maps import MeanSteps, level_maps, swings_kernel
from spikingtac.markers.calibration.offset_memory import OffsetMemory, remove_offsets_kernel
from spikingtac.markers.calibration.recording import BufferedEvents
from spikingtac.markers.calibration.swing_counts import count_swings_kernel
from spikingtac.markers.calibration.swings import steps_of_counts
from spikingtac.markers.calibration_check import (
    NEIGHBOUR_US,
    NEIGHBOURS,
    NO_ANSWER,
    RETURN_US,
    _note_first_kernel,
)

SIZE = (40, 30)
SHAPE = (30, 40)
DISCS = Discs(np.array([5.0, 4.5]), np.array([0.7, 1.0]), np.array([4.0, 2.5]))
PLACES = np.array([[12.3, 14.1], [28.6, 15.2]])


def random_events(count: int, seed: int) -> BufferedEvents:
    rng = np.random.default_rng(seed)
    code = rng.integers(0, 2 * SIZE[0] * SIZE[1], count).astype(np.uint32)
    return BufferedEvents(code, np.arange(count, dtype=np.uint32), SIZE, 0, count)


def few_pixels(count: int, seed: int) -> BufferedEvents:
    rng = np.random.default_rng(seed)
    code = rng.integers(0, 8, count).astype(np.uint32)
    return BufferedEvents(code, np.arange(count, dtype=np.uint32), SIZE, 0, count)


def random_steps(seed: int) -> PixelSteps:
    rng = np.random.default_rng(seed)
    on, off = rng.uniform(0.1, 0.4, (2, *SHAPE)).astype(np.float32)
    return PixelSteps(on, off)


UNSTRETCHED = np.zeros((2, 3))
STRETCH = np.array([[0.3, -0.4, 0.2], [0.0, 0.0, 0.5]])


def level(
    discs: Discs, places: np.ndarray, stretch: np.ndarray = UNSTRETCHED
) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    levels = []
    for m, (cx, cy) in enumerate(places):
        angle = np.arctan2(y - cy, x - cx)
        grown, cosine, sine = stretch[m]
        rim = discs.radius_px[m] + grown + cosine * np.cos(2 * angle) + sine * np.sin(2 * angle)
        profile = DiscProfile(float(discs.contrast[m]), float(discs.edge_px[m]))
        levels.append(profile.level(np.hypot(x - cx, y - cy) - rim))
    levels = np.array(levels)
    return levels.max(axis=0), levels.argmax(axis=0)


@pytest.mark.parametrize("count", [0, 1, 500])
def test_level_maps_equal_the_twin(count: int) -> None:
    events, steps = few_pixels(count, 3), MeanSteps(0.2, 0.3)
    index = np.unique(np.array([0, count // 3, count]))
    start = np.linspace(0.0, 1.0, events.pixels, dtype=np.float32).reshape(events.shape)
    got = level_maps(events, steps, index, start)
    value = start.ravel().astype(np.float64)
    forward, backward = [], []
    for code in events.code.tolist():
        change = steps.on if code & 1 else -steps.off
        value[code >> 1] = min(max(value[code >> 1] + change, 0.0), 1.0)
    for at in range(count, -1, -1):
        if at in index:
            backward.insert(0, value.copy())
        if at:
            code = int(events.code[at - 1])
            change = steps.on if code & 1 else -steps.off
            value[code >> 1] = min(max(value[code >> 1] - change, 0.0), 1.0)
    for at in range(count + 1):
        if at in index:
            forward.append(value.copy())
        if at < count:
            code = int(events.code[at])
            change = steps.on if code & 1 else -steps.off
            value[code >> 1] = min(max(value[code >> 1] + change, 0.0), 1.0)
    expected = 0.5 * (np.array(forward) + np.array(backward))
    np.testing.assert_allclose(got.reshape(len(index), -1), expected, atol=1e-5)


def test_swings_are_what_lies_between_two_turns() -> None:
    # Six up, four down, seven up, five down: the first and the last have no turn on both sides.
    ways = [1] * 6 + [0] * 4 + [1] * 7 + [0] * 5
    histogram = np.zeros(100, np.int64)
    swings_kernel(np.array(ways, np.uint32), 1.0, np.zeros((4, 1), np.float32), histogram)
    assert {int(i): int(histogram[i]) for i in np.flatnonzero(histogram)} == {24: 1, 16: 1, 28: 1}


@pytest.mark.parametrize("stretch", [UNSTRETCHED, STRETCH])
def test_discs_are_drawn_as_the_profile_says(stretch: np.ndarray) -> None:
    shape = stretched_kernel(DISCS.shape, stretch)
    image, owner = np.zeros(SHAPE, np.float32), np.full(SHAPE, -1, np.int32)
    touched = np.empty(image.size, np.int64)
    count = draw_kernel(PLACES, (shape, DISCS.tables), (image, owner), touched)
    expected, whose = level(DISCS, PLACES, stretch)
    np.testing.assert_allclose(image, expected, atol=0.012)  # the table ends at 6 edge widths
    assert count == np.count_nonzero(owner >= 0)
    assert sorted(touched[:count].tolist()) == np.flatnonzero(owner.ravel() >= 0).tolist()
    sure = image > 0.05
    np.testing.assert_array_equal(owner[sure], whose[sure])


def test_polarities_before_each_event_and_moves_both_ways_equal_the_twin() -> None:
    events, steps = few_pixels(300, 5), random_steps(6)
    last, before = np.zeros(events.pixels, np.int8), np.empty(300, np.int8)
    note_polarity_kernel(events.code, last, before)
    seen: dict[int, int] = {}
    for i, code in enumerate(events.code.tolist()):
        assert before[i] == seen.get(code >> 1, 0)
        seen[code >> 1] = 1 if code & 1 else -1
    start = np.random.default_rng(1).random(events.pixels).astype(np.float32)
    state = (start.copy(), np.zeros(events.pixels, np.int8))
    flat = (steps.on.ravel(), steps.off.ravel())
    move_kernel(state, (events.code, before), flat, 0, 300)
    expected = start.astype(float)
    for code in events.code.tolist():
        expected[code >> 1] += flat[0][code >> 1] if code & 1 else -flat[1][code >> 1]
    np.testing.assert_allclose(state[0], expected, atol=1e-4)
    np.testing.assert_array_equal(state[1], last)
    move_kernel(state, (events.code, before), flat, 300, 0)
    np.testing.assert_allclose(state[0], start, atol=1e-4)
    assert not state[1].any()


def test_levels_are_drawn_to_the_edge_of_their_band() -> None:
    value = np.array([0.0, 0.0, 1.0, 0.5], np.float32)
    wanted = np.array([1.0, 0.05, 0.0, 0.5], np.float32)
    on, off = np.full(4, 0.1, np.float32), np.full(4, 0.3, np.float32)
    pull_kernel(value, wanted, (on, off))
    np.testing.assert_allclose(value, [0.2 * 0.9, 0.0, 1.0 - 0.2 * 0.7, 0.5], atol=1e-6)


def test_a_fit_finds_a_disc_that_the_levels_show() -> None:
    drawn, _ = level(DISCS, PLACES)
    state = (drawn.astype(np.float32), np.zeros(SHAPE, np.int8))
    even = np.full(SHAPE, 0.1, np.float32)
    place = PLACES[0] + [0.9, -0.7]
    scene = (PLACES, nearest_markers(PLACES), DISCS.shape, DISCS.fit_tables)
    agreement = fit_kernel(state, (even, even), 0, place, scene, fit_room(DISCS.shape))
    assert np.hypot(*(place - PLACES[0])) < 0.02
    assert agreement > 0.99


def plain_sums(
    state: tuple[np.ndarray, np.ndarray], on: float, off: float, m: int, place: np.ndarray
) -> list[float]:
    """The normal equations of a disc's centre, pixel by pixel, from the profile itself."""
    sums = [0.0] * 7
    radius, edge = DISCS.radius_px[m], DISCS.edge_px[m]
    profile = DiscProfile(float(DISCS.contrast[m]), 1.0)
    for y, x in np.ndindex(SHAPE):
        dx, dy = x - place[0], y - place[1]
        rho = np.hypot(dx, dy)
        q = rho - radius
        others = [n for n in range(len(PLACES)) if n != m]
        nearer = [np.hypot(*(PLACES[n] - (x, y))) - DISCS.radius_px[n] < q for n in others]
        if q > 3.5 * edge + 1.0 or q < -4.5 * edge - 1.0 or rho < 0.5 or any(nearer):
            continue
        side = state[1][y, x]
        ahead = {1: 0.5 * on, -1: -0.5 * off, 0: 0.5 * (on - off)}[int(side)]
        spread = {1: on, -1: off, 0: on + off}[int(side)]
        expected = float(profile.level(np.array(q / edge)))
        error = state[0][y, x] + ahead - expected
        weight = 1.0 / ((0.003 + spread**2 / 12.0) * (1.0 + (error / 0.3) ** 2))
        if state[0][y, x] - off <= expected <= state[0][y, x] + on:
            weight *= 0.6
        slope = -float(profile.slope(np.array(q / edge))) / edge
        gx, gy = slope * dx / rho, slope * dy / rho
        rows = (gx * gx, gx * gy, gy * gy, gx * error, gy * error)
        sums = [one + weight * row for one, row in zip(sums, rows, strict=False)] + sums[5:]
        sums[5] += slope
        sums[6] += slope if abs(error) < 0.35 else 0.0
    return sums


@pytest.mark.parametrize("gap_px", [20.0, 13.0])  # the discs' surroundings apart, and overlapping
def test_normal_equations_equal_plain_sums(gap_px: float, monkeypatch: pytest.MonkeyPatch) -> None:
    places = np.array([[12.3, 14.1], [12.3 + gap_px, 15.2]])
    monkeypatch.setitem(plain_sums.__globals__, "PLACES", places)
    rng = np.random.default_rng(8)
    drawn, _ = level(DISCS, places)
    state = (
        (drawn + rng.normal(0, 0.1, SHAPE)).astype(np.float32),
        rng.integers(-1, 2, SHAPE).astype(np.int8),
    )
    steps = np.full(SHAPE, 0.1, np.float32), np.full(SHAPE, 0.2, np.float32)
    scene = (places, nearest_markers(places), DISCS.shape, DISCS.fit_tables)
    room, place = fit_room(DISCS.shape), places[0] + [0.4, -0.3]
    count = gather_kernel(state, steps, place, 11.0, room)
    claim_kernel(room, count, 0, place, scene)
    assert (room[6, :count] == 0.0).any() == (gap_px < 14.0)
    look = DISCS.radius_px[0], DISCS.edge_px[0]
    sums = sums_kernel(room, count, look, place, DISCS.fit_tables[0])
    # Tables are not the profile itself; a level at the end of a band may fall to the other side.
    expected = plain_sums(state, 0.1, 0.2, 0, place)
    np.testing.assert_allclose(sums, expected, rtol=2e-3, atol=0.3)


def test_pixels_are_gathered_again_for_a_fit_that_moves_far() -> None:
    drawn, _ = level(DISCS, PLACES)
    state = (drawn.astype(np.float32), np.zeros(SHAPE, np.int8))
    even = np.full(SHAPE, 0.1, np.float32)
    scene = (PLACES, nearest_markers(PLACES), DISCS.shape, DISCS.fit_tables)
    place = PLACES[0] + [2.6, 0.0]
    fit_kernel(state, (even, even), 0, place, scene, fit_room(DISCS.shape))
    assert np.hypot(*(place - PLACES[0])) < 0.1


def test_disbelieved_discs_are_led_by_their_neighbours() -> None:
    start = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    center = start + np.array([[5.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    lead_kernel(center, start, np.array([0.1, 0.9, 0.9]), nearest_markers(start))
    np.testing.assert_allclose(center[0], [5.0 - 0.3 * 3.0, 0.0])
    np.testing.assert_allclose(center[1:], start[1:] + np.array([2.0, 0.0]))


def twin_walk(
    course: Course, steps: PixelSteps, phases: int, kept: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Mean sums of ideal pixels' steps at each sample, and all events that they fire."""
    on, off = steps.on.astype(float), steps.off.astype(float)
    stretches = course.stretch_px
    assert stretches is not None
    now = level(DISCS, course.center_px[0], stretches[0])[0]
    shares = (np.arange(phases) + 0.5) / phases
    last = now[..., None] + off[..., None] - (on + off)[..., None] * shares
    means, fired, total, before = [], np.zeros(2), np.zeros(on.shape), now[..., None]
    for center_px, stretch, share in zip(course.center_px, stretches, kept, strict=True):
        now = level(DISCS, center_px, stretch)[0][..., None]
        lost = np.where(now != before, (last - 0.5 * (now + before)).clip(0.0), 0.0)
        last, before = last - (1.0 - share) * lost, now
        start = last
        for _ in range(20):
            rises, falls = now > last + on[..., None], now < last - off[..., None]
            last = last + rises * on[..., None] - falls * off[..., None]
            fired += rises.sum(), falls.sum()
        total = total + (last - start).mean(axis=2)
        means.append(total)
    return means, fired / phases


@pytest.mark.parametrize("recovery_s", [0.0, 0.03])
def test_ideal_pixels_fire_as_the_twins_do(recovery_s: float) -> None:
    path = np.array([[0.0, 0.0], [1.5, 0.5], [4.0, 1.0], [2.0, 0.0], [0.0, 0.0]])
    events, steps = random_events(200, 9), random_steps(10)
    stretches = np.array([0.0, 1.0, 0.5, -1.0, 0.0])[:, None, None] * STRETCH
    index = np.array([0, 50, 90, 150, 200])
    course = Course(index, PLACES + path[:, np.newaxis], np.ones((5, 2)), stretches)
    states = np.arange(5)
    seen = walk(events, course, states, DISCS, steps, recovery_s)
    after_s = np.diff(events.times_at(index), prepend=events.times_at(index)[:1]) * 1e-6
    kept = np.exp(-after_s / recovery_s) if recovery_s else np.ones(5)
    means, fired = twin_walk(course, steps, PHASES, kept)
    for state, mean in enumerate(means):
        # A level near a threshold may fall to the other side in a table.
        apart = np.abs(seen.expected[state] - mean)
        assert np.mean(apart > 0.02) < 0.02
    np.testing.assert_allclose(seen.events[:, 2:].sum(axis=0), fired, rtol=0.03)
    total = np.zeros(events.pixels)
    for code in events.code[:150].tolist():
        pixel = code >> 1
        total[pixel] += steps.on.flat[pixel] if code & 1 else -steps.off.flat[pixel]
    np.testing.assert_allclose(seen.measured[3].ravel(), total, atol=1e-5)


def test_offsets_are_weighted_means_over_the_states_around() -> None:
    rng = np.random.default_rng(2)
    error = rng.normal(size=(7, 5)).astype(np.float32)
    drawn = rng.choice([0.0, 0.5, 1.0], (7, 5)).astype(np.float32)
    got = error.copy()
    remove_offsets_kernel(got[np.newaxis], drawn, 4.0, 0.1)
    apart = np.abs(np.arange(7)[:, None] - np.arange(7))
    weight = np.exp(-apart / 4.0)[:, :, None] * np.where(drawn == 0.5, 0.1, 1.0)
    expected = error - (weight * error).sum(axis=1) / weight.sum(axis=1)
    np.testing.assert_allclose(got, expected, atol=1e-5)


# A place that moves turns the ellipse a little, which the kernel leaves to the next round.
@pytest.mark.parametrize(("stretch", "rows"), [(UNSTRETCHED, range(6)), (STRETCH, range(2, 6))])
def test_slopes_of_a_disc_equal_numbers_from_differences(stretch: np.ndarray, rows: range) -> None:
    corner, small = (8, 4), 1e-4
    slopes = np.zeros((6, 1, 14, 16), np.float32)
    shape = stretched_kernel(DISCS.shape, stretch)
    scene = (PLACES[np.newaxis], nearest_markers(PLACES), shape[np.newaxis])
    slopes_kernel(scene, 0, corner, slopes)

    def seen(dx: float, dy: float, *change: float) -> np.ndarray:
        growth, wider, cosine, sine = change
        disc = Discs(np.array([5.0 + growth]), np.array([0.7 + wider]), np.array([4.0]))
        stretched = np.add(stretch[:1], [0.0, cosine, sine])
        return level(disc, np.add(PLACES[:1], [dx, dy]), stretched)[0][8:22, 4:20]

    near = slopes[2, 0] != 0.0
    assert near.sum() > 100
    for row in rows:
        step = small * np.eye(6)[row]
        expected = (seen(*step) - seen(*-step)) / (2 * small)
        np.testing.assert_allclose(slopes[row, 0][near], expected[near], atol=2e-4)


def test_corrections_undo_small_errors_although_offsets_are_unknown() -> None:
    path = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [-2.0, -2.0], [0.0, 0.0]])
    places = PLACES + path[:, np.newaxis]
    # All places of the first disc are off by the same way, one of the second by another, and it is
    # stretched there.
    shift, move = np.array([0.06, -0.04]), np.array([0.05, 0.03])
    true, stretches = places.copy(), np.zeros((5, 2, 3))
    true[:, 0] += shift
    true[3, 1] += move
    stretches[3, 1] = [0.0, 0.06, -0.05]
    shown = np.array([level(DISCS, at, by)[0] for at, by in zip(true, stretches, strict=True)])
    drawn = np.array([level(DISCS, at)[0] for at in places])
    offset = np.random.default_rng(4).normal(0, 0.5, SHAPE)
    even = np.full(SHAPE, 0.1, np.float32)
    expected = drawn.astype(np.float32)
    seen = Walk((shown + offset).astype(np.float32), expected, expected, np.zeros((2, 4)))
    steps, memory = PixelSteps(even, even), OffsetMemory(4.0, 0.1)
    found = corrections(seen, (places, np.zeros((5, 2, 3))), DISCS, steps, memory)
    np.testing.assert_allclose(found.common_px[0], [*shift, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(found.common_px[1], 0.0, atol=0.04)
    total = found.move_px + found.common_px[:, :2]
    assert np.abs(total[3, 1] - move).max() < 0.03
    assert np.abs(found.stretch_px[3, 1] - stretches[3, 1]).max() < 0.03
    assert np.abs(found.stretch_px[:, 0]).max() < 0.02
    np.testing.assert_allclose(found.stretch_px[:, :, 0].mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("rows", [slice(0, SIZE[1]), slice(5, 25)])
def test_full_swings_are_counted_pixel_by_pixel(rows: slice) -> None:
    # One disc comes over a pixel, rests, and leaves it: three ON events and one OFF event against
    # them, then two OFF events.
    discs = Discs(np.array([5.0]), np.array([0.5]), np.array([4.0]))
    pixel = 15 * SIZE[0] + 20
    ways = [1, 1, 0, 1, 0, 0]
    code = np.array([2 * pixel + way for way in ways], np.uint32)
    away, over = [[4.0, 15.0]], [[20.0, 15.0]]
    center_px = np.array([away, away, over, over, over, over, away, away, away, away])
    index = np.array([0, 0, 4, 4, 4, 4, 6, 6, 6, 6])
    by_marker, shape = np.zeros((1, 6)), (rows.stop - rows.start, SIZE[0])
    by_pixel = np.zeros((shape[0] * shape[1], 6), np.float32)
    first = rows.start * SIZE[0]
    count_swings_kernel(
        (np.insert(code, 0, 0), first),  # the pixel in the corner may lie outside
        (index + 1, center_px - [0.0, rows.start]),
        (discs.shape, discs.tables),
        np.zeros(shape, np.float32),
        (by_marker, by_pixel),
    )
    np.testing.assert_array_equal(by_pixel[pixel - first], [3, 1, 2, 1, 1, 0])
    assert by_marker[0, 1] > 1  # other pixels swung as well, without events
    assert by_marker[0, 0] == 3


def test_steps_solve_both_equations() -> None:
    on, off = steps_of_counts(np.array([8.0, 3.0]), np.array([2.0, 3.0]))
    np.testing.assert_allclose(on * (np.array([8.0, 3.0]) + 0.5) + off / 2, 1.0)
    np.testing.assert_allclose(off * (np.array([2.0, 3.0]) + 0.5) + on / 2, 1.0)


def test_first_events_with_company_are_noted_as_by_plain_loops() -> None:
    rng = np.random.default_rng(5)
    height, width, count = 6, 7, 600
    x, y = rng.integers(0, width, count), rng.integers(0, height, count)
    rises, t = rng.random(count) < 0.5, np.sort(rng.integers(0, 400_000, count))
    t[-150:] += RETURN_US
    asked = rng.random((height, width)) < 0.7
    first, last_us = np.zeros((height, width), np.int8), np.full((2, height, width), -(10**12))
    events = (x.astype(np.uint16), y.astype(np.uint16), rises, t.astype(np.int64))
    _note_first_kernel(events, asked, first, last_us)
    expected = np.zeros((height, width), np.int8)
    for i in range(count):
        before = [
            (x[k], y[k])
            for k in range(i)
            if rises[k] == rises[i]
            and max(abs(int(x[k]) - x[i]), abs(int(y[k]) - y[i])) == 1
            and t[i] - t[k] < NEIGHBOUR_US
        ]
        company = len(set(before))
        if asked[y[i], x[i]] and not expected[y[i], x[i]] and company >= NEIGHBOURS:
            own = [k for k in range(i) if (x[k], y[k]) == (x[i], y[i])]
            back = [k for k in own if rises[k] != rises[i]]
            back = [k for k in back if k == own[-1] or t[i] - t[k] < RETURN_US]
            expected[y[i], x[i]] = NO_ANSWER if back else 1 if rises[i] else -1
    assert (first == expected).all()
    assert set(np.unique(first)) == {-1, 0, 1, NO_ANSWER}


def test_sums_and_moves_of_corrections_equal_plain_arrays() -> None:
    rng = np.random.default_rng(11)
    states, pixels = 5, 40
    error = rng.normal(0, 0.3, (states, pixels)).astype(np.float32)
    slopes = rng.normal(size=(4, states, pixels)).astype(np.float32)
    slopes[:, rng.random((states, pixels)) < 0.3] = 0.0
    shared = rng.normal(size=(4, states, pixels)).astype(np.float32)
    variance = rng.uniform(0.01, 0.02, pixels).astype(np.float32)
    weight = np.empty((states, pixels), np.float32)
    curvature, pull = np.eye(4), np.zeros(4)
    squares, weights = common_sums_kernel(
        error, slopes[2], variance, (shared, weight), (curvature, pull)
    )
    plain = (slopes[2] != 0) / variance / (1.0 + (error.astype(float) / RESIDUAL_LEVEL) ** 2)
    np.testing.assert_allclose(weight, plain, rtol=1e-5)
    assert squares == pytest.approx((plain * error.astype(float) ** 2).sum())
    assert weights == pytest.approx(plain.sum())
    rows = shared.reshape(4, -1).astype(float)
    np.testing.assert_allclose(
        curvature, np.tril(np.eye(4) + (rows * plain.ravel()) @ rows.T), rtol=1e-5
    )
    np.testing.assert_allclose(pull, rows @ (plain * error).ravel(), rtol=1e-5)

    step, own = np.array([0.1, -0.2, 0.05, 0.02]), slopes[[0, 1, 3]]
    curvatures, pulls = np.tile(np.eye(3), (states, 1, 1)), np.zeros((states, 3))
    state_sums_kernel(error, weight, own, (shared, step), (curvatures, pulls))
    left = error - np.tensordot(step, shared.astype(float), 1)
    for state in range(states):
        rows = own[:, state].astype(float)
        normal = (rows * weight[state]) @ rows.T + np.eye(3)
        np.testing.assert_allclose(curvatures[state], normal, rtol=1e-6)
        np.testing.assert_allclose(pulls[state], rows @ (weight[state] * left[state]), rtol=1e-5)
