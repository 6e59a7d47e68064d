"""The kernels behind the calibration against plain loops, on random and edge events."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile, Discs, draw_kernel
from spikingtac.markers.calibration.corrections import Changes, _solved, corrections, rims
from spikingtac.markers.calibration.find_markers import Evidence
from spikingtac.markers.calibration.first_model import steps_of_counts
from spikingtac.markers.calibration.ideal_pixels import PHASES, SNAP_S, Comparison, Model, compare
from spikingtac.markers.calibration.level_maps import level_maps, swings_kernel
from spikingtac.markers.calibration.recording import coded, times_at
from spikingtac.markers.calibration.refine import with_rest_radii
from spikingtac.markers.calibration_check import (
    MOVED_EVENTS,
    NEIGHBOUR_US,
    NEIGHBOURS,
    NO_ANSWER,
    RETURN_US,
    _note_first_kernel,
)
from spikingtac.types import EventPacket
from stand_ins.random_packets import decoded

SIZE, SHAPE = (40, 30), (30, 40)
PIXELS = SIZE[0] * SIZE[1]
DISCS = Discs(np.array([4.0, 2.5]), np.array([0.7, 1.0]), np.array([5.0, 4.5]))
PLACES = np.array([[12.3, 14.1], [28.6, 15.2]])


def some_events(count: int, seed: int, codes: int = 2 * PIXELS) -> EventPacket:
    code = np.random.default_rng(seed).integers(0, codes, count)
    return decoded(code, np.arange(count), SIZE, count)


def random_steps(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.4, (2, PIXELS)).astype(np.float32)


UNSTRETCHED = np.zeros((2, 3))
STRETCH = np.array([[0.3, -0.4, 0.2], [0.0, 0.0, 0.5]])


def level(
    discs: Discs, places: np.ndarray, stretch: np.ndarray = UNSTRETCHED
) -> tuple[np.ndarray, np.ndarray]:
    """Return levels and owners from the profile itself."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    levels = []
    for m, (cx, cy) in enumerate(places):
        angle = np.arctan2(y - cy, x - cx)
        grown, cosine, sine = stretch[m]
        rim = discs.radius_px[m] + grown + cosine * np.cos(2 * angle) + sine * np.sin(2 * angle)
        profile = DiscProfile(float(discs.contrast[m]), float(discs.edge_px[m]))
        levels.append(profile.level(np.hypot(x - cx, y - cy) - rim))
    return np.max(levels, axis=0), np.argmax(levels, axis=0)


@pytest.mark.parametrize("count", [0, 1, 500])
def test_level_maps_equal_the_twin(count: int) -> None:
    events, steps = some_events(count, 3, codes=8), np.array([0.2, 0.3], np.float32)
    index = np.unique(np.array([0, count // 3, count]))
    start = np.linspace(0.0, 1.0, events.pixels, dtype=np.float32).reshape(events.shape)
    got = level_maps(events, steps, index, start)
    value, codes = start.ravel().astype(np.float64), coded(events).tolist()
    forward, backward = [], []

    def take(code: int, way: float) -> None:
        change = way * (steps[0] if code & 1 else -steps[1])
        value[code >> 1] = min(max(value[code >> 1] + change, 0.0), 1.0)

    for code in codes:
        take(code, 1.0)
    for at in range(count, -1, -1):
        if at in index:
            backward.insert(0, value.copy())
        if at:
            take(codes[at - 1], -1.0)
    for at in range(count + 1):
        if at in index:
            forward.append(value.copy())
        if at < count:
            take(codes[at], 1.0)
    expected = 0.5 * (np.array(forward) + np.array(backward))
    np.testing.assert_allclose(got.reshape(len(index), -1), expected, atol=1e-5)


def test_swings_are_what_lies_between_two_turns() -> None:
    # Six up, four down, seven up, five down: the first and the last have no turn on both sides.
    ways = [1] * 6 + [0] * 4 + [1] * 7 + [0] * 5
    histogram, group = np.zeros((2, 100), np.int64), np.ones(1, np.int64)
    swings_kernel(np.array(ways, np.uint32), 1.0, np.zeros((4, 1), np.float32), group, histogram)
    found = {int(i): int(histogram[1, i]) for i in np.flatnonzero(histogram[1])}
    assert found == {24: 1, 16: 1, 28: 1}
    assert not histogram[0].any()


@pytest.mark.parametrize("stretch", [UNSTRETCHED, STRETCH])
def test_discs_are_drawn_as_the_profile_says(stretch: np.ndarray) -> None:
    image, owner = np.zeros(SHAPE, np.float32), np.full(SHAPE, -1, np.int32)
    touched = np.empty(image.size, np.int64)
    count = draw_kernel((PLACES, stretch), DISCS.looks, (image, owner), touched)
    expected, whose = level(DISCS, PLACES, stretch)
    np.testing.assert_allclose(image, expected, atol=0.012)  # the table ends at the disc's reach
    assert sorted(touched[:count].tolist()) == np.flatnonzero(owner.ravel() >= 0).tolist()
    np.testing.assert_array_equal(owner[image > 0.05], whose[image > 0.05])


def evidence_and_model(
    places: np.ndarray, events: EventPacket | None = None, **looks: Any
) -> tuple[Evidence, Model]:
    states, rests, none = np.arange(len(places)), np.empty(0, np.int64), np.zeros(2)
    cell = np.where(np.arange(PIXELS) % SIZE[0] < 20, 0, 1)
    known = Evidence(events or some_events(1, 1), states, states, rests, cell, none, 0.0)
    steps, even, stretch = np.full((2, 2), 0.1), np.ones((2, PIXELS)), np.zeros((len(places), 2, 3))
    model = Model(places, stretch, DISCS, steps, even, none)
    return known, replace(model, **looks)


def plain_comparison(
    paths: tuple[np.ndarray, np.ndarray], steps: np.ndarray, kept: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Mean sums of ideal pixels' steps at each sample, and all events that they fire."""
    on, off = (step.astype(float).reshape(SHAPE) for step in steps)
    now = level(DISCS, *(path[0] for path in paths))[0]
    shares = (np.arange(PHASES) + 0.5) / PHASES
    last = now[..., None] + off[..., None] - (on + off)[..., None] * shares
    means, fired, total, before = [], np.zeros(2), np.zeros(on.shape), now[..., None]
    for place, stretch, share in zip(*paths, kept, strict=True):
        now = level(DISCS, place, stretch)[0][..., None]
        lost = np.where(now != before, (last - 0.5 * (now + before)).clip(0.0), 0.0)
        last, before = last - (1.0 - share) * lost, now
        start = last
        for _ in range(20):
            rises, falls = now > last + on[..., None], now < last - off[..., None]
            last = last + rises * on[..., None] - falls * off[..., None]
            fired += rises.sum(), falls.sum()
        total = total + (last - start).mean(axis=2)
        means.append(total)
    return means, fired / PHASES


@pytest.mark.parametrize("recovery_s", [0.0, 0.03])
def test_ideal_pixels_fire_as_plain_loops_have_it(recovery_s: float) -> None:
    way = np.array([[0.0, 0.0], [1.5, 0.5], [4.0, 1.0], [2.0, 0.0], [0.0, 0.0]])
    events, steps = some_events(200, 9), random_steps(10)
    index = np.array([0, 50, 90, 150, 200])
    stretches = np.array([0.0, 1.0, 0.5, -1.0, 0.0])[:, None, None] * STRETCH
    paths = PLACES + way[:, np.newaxis], stretches
    looks = {"stretch_px": stretches, "pixel": 10.0 * steps}
    known, model = evidence_and_model(paths[0], events, **looks, recovery_s=recovery_s)
    seen = compare(replace(known, index=index), model)
    after_s = np.diff(times_at(events, index), prepend=times_at(events, index[:1])) * 1e-6
    kept = np.exp(-after_s / recovery_s) if recovery_s else np.ones(5)
    means, fired = plain_comparison(paths, steps, kept)
    # A level near a threshold may fall to the other side in a table.
    shown = np.array(means).reshape(5, -1)
    assert (np.abs(seen.expected - shown[:, seen.pixel]) > 0.02).mean(axis=1).max() < 0.02
    assert np.abs(np.delete(shown, seen.pixel, axis=1)).max() < 0.02
    np.testing.assert_allclose(seen.events[1].sum(axis=1), fired, rtol=0.03)
    noisy = compare(replace(known, index=index, noise_hz_px=np.array([2.0, 3.0])), model).events[0]
    looked_s = np.logical_or.accumulate(seen.owner >= 0)[:-1].sum(axis=1) @ after_s[1:]
    np.testing.assert_allclose((seen.events[0] - noisy).sum(axis=1), [2 * looked_s, 3 * looked_s])
    total = np.zeros(PIXELS)
    for code in coded(events)[:150].tolist():
        pixel = code >> 1
        total[pixel] += steps[0][pixel] if code & 1 else -steps[1][pixel]
    np.testing.assert_allclose(seen.measured[3], total[seen.pixel], atol=1e-5)


@pytest.mark.parametrize(("back", "snaps"), [(False, False), (True, False), (True, True)])
def test_full_swings_are_counted_pixel_by_pixel_but_for_snaps(back: bool, snaps: bool) -> None:
    # One disc leaves a pixel, which does not count, comes over it, rests, and leaves it: three ON
    # events and one OFF event against them, then two OFF events, the last of which comes late.
    discs = Discs(np.array([4.0]), np.array([0.5]), np.array([5.0]))
    pixel = 15 * SIZE[0] + 20
    code = np.array([2 * pixel + way for way in (1, 1, 0, 1, 0, 0, 1)])
    at_us = np.arange(7) * int(1e6 * SNAP_S / (4 if snaps else 1) + 1)
    events = decoded(code, at_us, SIZE, 7 * int(at_us[1]))
    away, near, over = [[4.0, 15.0]], [[12.5, 15.0]], [[20.0, 15.0]]
    # Noise long after the swing is none of its events, nor where the disc has gone away.
    coming = [over, away, near, over, over, near, near]
    path = np.array([*coming, *([away] if back else [near]) * 4, near])
    index = np.array([0, 0, 0, 3, 4, 5, 6, 6, 6, 6, 6, 7])
    known, model = evidence_and_model(path, events, discs=discs)
    seen = compare(replace(known, index=index), model)
    expected = np.zeros((2, 3)) if snaps else [[3, 1, 1], [2, 1, 0]]
    np.testing.assert_allclose(seen.swings[pixel], expected, atol=0.02)
    # ON noise of 2 and OFF noise of 3 Hz is subtracted, for as long as each swing takes.
    noisy = compare(replace(known, index=index, noise_hz_px=np.array([2.0, 3.0])), model)
    spans_s = (not snaps) * 1e-6 * np.diff(times_at(events, index)[[2, 4, 6]])[:, np.newaxis]
    less = (seen.swings[pixel] - noisy.swings[pixel])[:, ::2]
    np.testing.assert_allclose(less, spans_s * [[2.0, 3.0], [3.0, 2.0]], atol=1e-9)
    # A pixel near the rim, sqrt(13) px from the centre, swings less high.
    height = 0.0 if snaps else DiscProfile(4.0, 0.5).level(13**0.5 - 5.0)
    np.testing.assert_allclose(seen.swings[17 * SIZE[0] + 23, 0, 1], height, atol=0.002)
    # Other pixels swing as well, without events.
    assert (seen.marker_swings[0, 0, 1] > 50) != snaps
    assert seen.marker_swings[0, 0, 0] == (0 if snaps else 3)


def test_discs_have_the_radii_of_their_rests() -> None:
    stretch_px = np.random.default_rng(5).normal(size=(5, 2, 3))
    _, model = evidence_and_model(np.zeros((5, 2, 2)), stretch_px=stretch_px)
    rested = with_rest_radii(model, np.array([1, 3]))
    grown_px = rested.discs.radius_px + rested.stretch_px[..., 0]
    np.testing.assert_allclose(grown_px, DISCS.radius_px + stretch_px[..., 0])
    np.testing.assert_allclose(rested.stretch_px[[1, 3], :, 0].sum(axis=0), 0.0, atol=1e-12)


def test_steps_solve_both_equations() -> None:
    steps = steps_of_counts(counts := np.array([[8.0, 3.0], [2.0, 3.0]]))
    np.testing.assert_allclose(steps * (counts + 0.5) + steps[::-1] / 2, 1.0)


def seen_at(measured: np.ndarray, drawn: np.ndarray, owner: np.ndarray) -> Comparison:
    flat = [image.reshape(len(drawn), -1).astype(np.float32) for image in (measured, drawn, drawn)]
    owners = owner.reshape(len(drawn), -1).astype(np.int32)
    none, pixel = np.zeros((2, 2, 2)), np.arange(owners.shape[1])
    return Comparison(pixel, flat[0], flat[1], flat[2], owners, none, none, none)


def test_offsets_are_weighted_means_over_the_states_around() -> None:
    rng = np.random.default_rng(2)
    drawn = rng.choice([0.0, 0.5, 1.0], (7, 5))
    levels = rng.normal(size=(7, 5)).astype(np.float32)
    found = Changes(drawn, 4.0, 0.1).of(levels)
    apart = np.abs(np.arange(7)[:, None] - np.arange(7))
    weight = np.exp(-apart / 4.0)[:, :, None] * np.where(drawn == 0.5, 0.1, 1.0)
    expected = levels - (weight * levels).sum(axis=1) / weight.sum(axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_each_group_is_solved_by_weighted_least_squares_with_a_prior() -> None:
    rng = np.random.default_rng(6)
    group, slopes = rng.integers(0, 3, 50), rng.normal(size=(4, 50)).astype(np.float32)
    error, weight = rng.uniform(0.5, 2.0, (2, 50)).astype(np.float32)
    prior, towards = (1.0, 2.0, 3.0, 4.0), rng.normal(size=(4, 4))
    found = _solved(group, (slopes, error, weight), prior, towards)
    for one in range(4):  # the last group has no pixel
        a, w = slopes[:, group == one].astype(float), weight[group == one]
        pull = prior * towards[one] + a @ (w * error[group == one])
        np.testing.assert_allclose((np.diag(prior) + (w * a) @ a.T) @ found[one], pull, rtol=1e-4)


# A place that moves turns the ellipse a little, which the model leaves to the next round.
@pytest.mark.parametrize(("stretch", "rows"), [(UNSTRETCHED, range(6)), (STRETCH, range(2, 6))])
def test_slopes_of_a_disc_equal_numbers_from_differences(stretch: np.ndarray, rows: range) -> None:
    known, model = evidence_and_model(PLACES[np.newaxis])
    model = replace(model, stretch_px=stretch[np.newaxis])
    drawn, owner = level(DISCS, PLACES)
    around = rims(known, model, seen_at(drawn[np.newaxis], drawn[np.newaxis], owner[np.newaxis]))
    first = around.marker == 0
    assert first.sum() > 100
    small = 1e-4

    def shown(dx: float, dy: float, growth: float, wider: float, *ellipse: float) -> np.ndarray:
        disc = Discs(np.array([4.0]), np.array([0.7 + wider]), np.array([5.0 + growth]))
        stretched = np.add(stretch[:1], [0.0, *ellipse])
        return level(disc, np.add(PLACES[:1], [dx, dy]), stretched)[0].ravel()[around.at[first]]

    for row in rows:
        change = small * np.eye(6)[row]
        expected = (shown(*change) - shown(*-change)) / (2 * small)
        np.testing.assert_allclose(around.slopes[row, first], expected, atol=2e-4)


def test_corrections_undo_small_errors_although_offsets_are_unknown() -> None:
    way = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [-2.0, -2.0], [0.0, 0.0]])
    places = PLACES + way[:, np.newaxis]
    # All places of the first disc are off by the same way, one of the second by another, and it is
    # stretched there.
    shift, move = np.array([0.06, -0.04]), np.array([0.05, 0.03])
    true = places.copy()
    true[:, 0] += shift
    true[3, 1] += move
    stretches = np.zeros((5, 2, 3))
    stretches[3, 1] = [0.0, 0.06, -0.05]
    measured = np.array([level(DISCS, *both)[0] for both in zip(true, stretches, strict=True)])
    measured += np.random.default_rng(4).normal(0, 0.5, SHAPE)
    drawn, owner = (
        np.array(both) for both in zip(*[level(DISCS, at) for at in places], strict=True)
    )
    known, model = evidence_and_model(places)
    seen = seen_at(measured, drawn, owner)
    common_px, own_px, _ = corrections(known, model, seen)
    np.testing.assert_allclose(common_px[:, :2], np.array([shift, [0.0, 0.0]]), atol=0.03)
    # Few pixels tell the shapes: they are drawn a little to their medians.
    np.testing.assert_allclose(common_px[:, 2:], 0.0, atol=0.07)
    assert np.abs(own_px[3, 1, :2] + common_px[1, :2] - move).max() < 0.03
    assert np.abs(own_px[3, 1, 2:] - stretches[3, 1]).max() < 0.03
    assert np.abs(own_px[:, 0, 2:]).max() < 0.02
    np.testing.assert_allclose(own_px[..., 2].mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_first_events_with_company_are_noted_as_by_plain_loops(share: float) -> None:
    rng = np.random.default_rng(5)
    height, width, count = 6, 7, 600
    x, y = rng.integers(0, width, count), rng.integers(0, height, count)
    rises, t = rng.random(count) < 0.5, np.sort(rng.integers(0, 400_000, count))
    t[-150:] += RETURN_US
    asked = rng.random((height, width)) < 0.7
    first, last_us = np.zeros((height, width), np.int8), np.full((2, height, width), -(10**12))
    events = (x.astype(np.uint16), y.astype(np.uint16), rises, t.astype(np.int64))
    net = np.zeros((height, width), np.int32)
    _note_first_kernel(events, asked, first, last_us, net, share)
    expected = np.zeros((height, width), np.int8)
    for i in range(count):
        before = [
            (x[k], y[k])
            for k in range(i)
            if rises[k] == rises[i]
            and max(abs(int(x[k]) - x[i]), abs(int(y[k]) - y[i])) == 1
            and t[i] - t[k] < share * NEIGHBOUR_US
        ]
        company = len(set(before))
        if asked[y[i], x[i]] and not expected[y[i], x[i]] and company >= NEIGHBOURS:
            own = [k for k in range(i) if (x[k], y[k]) == (x[i], y[i])]
            back = [k for k in own if rises[k] != rises[i]]
            back = [k for k in back if k == own[-1] or t[i] - t[k] < share * RETURN_US]
            against = sum(1 if rises[k] != rises[i] else -1 for k in own)
            unknown = back or against >= MOVED_EVENTS
            expected[y[i], x[i]] = NO_ANSWER if unknown else 1 if rises[i] else -1
    assert (first == expected).all()
    assert set(np.unique(first)) == {-1, 0, 1, NO_ANSWER}
