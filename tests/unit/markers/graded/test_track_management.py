"""Which markers are held, how sure they are of themselves, and how they come back."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.hot_pixels import HOT
from spikingtac.events.windows import windows
from spikingtac.markers.graded import track_management
from spikingtac.markers.graded.misplaced_skin import (
    MisplacedSkin,
    light_rise_kernel,
    mean_motion_kernel,
    rim_events_kernel,
)
from spikingtac.markers.graded.track_management import TrackManager
from spikingtac.markers.graded.tracker import GradedTracker, GradedTrackerConfig
from spikingtac.state_map.binary import paint_discs
from spikingtac.state_map.graded import PIXEL, GradedStateMap
from stand_ins.ideal_events import ideal_events
from stand_ins.known import moving_markers
from stand_ins.random_packets import packet_of

SIZE = (210, 210)
PITCH_PX, COUNT = 40.0, 25
REST_PX = 25.0 + PITCH_PX * np.stack(np.meshgrid(np.arange(5), np.arange(5)), -1).reshape(-1, 2)
RADIUS_PX = np.full(COUNT, 6.0)
CALIBRATION = Calibration(reference_px=REST_PX, radius_px=RADIUS_PX, grid=(5, 5), size=SIZE)
AGREED = np.ones(COUNT)
LATER_US = 100_000
CENTRE, CORNER = 12, 0
EVENTS_PER_PX = np.full(COUNT, 170.0)
NOISE_HZ = np.full(COUNT, 300.0)
DT_S = 1e-3


def levels(center_px: np.ndarray) -> np.ndarray:
    return paint_discs(SIZE, center_px, RADIUS_PX[: len(center_px)])


BLIND = levels(np.delete(REST_PX, CENTRE, axis=0))


def doubtful(marker: int = CENTRE) -> np.ndarray:
    agreement = AGREED.copy()
    agreement[marker] = 0.1
    return agreement


def lost() -> TrackManager:
    manager = TrackManager(CALIBRATION)
    for t_us in (0, LATER_US):
        manager.update(t_us, fits(REST_PX, doubtful()), BLIND)
    assert np.flatnonzero(manager.coasted).tolist() == [CENTRE]
    return manager


def fits(place_px: np.ndarray, agreement: np.ndarray) -> np.ndarray:
    markers = moving_markers(place_px)
    markers["agreement"] = agreement
    return markers


def listen(
    manager: TrackManager, velocity_px_s: np.ndarray, events: np.ndarray, ratio: float = 1.0
) -> None:
    loss = SimpleNamespace(arrival_ratio=ratio, noise_per_s=NOISE_HZ, events_per_px=EVENTS_PER_PX)
    manager.update_silent(moving_markers(REST_PX, velocity_px_s), events, DT_S, loss)  # type: ignore[arg-type]


def moving(speed_px_s: float) -> np.ndarray:
    return np.tile([0.6 * speed_px_s, 0.8 * speed_px_s], (COUNT, 1))


def heard(
    velocity_px_s: np.ndarray, sent: np.ndarray, share: float = 1.0, steps: int = 150
) -> TrackManager:
    """Let every marker send a share of what its own motion asks for."""
    manager, rng = TrackManager(CALIBRATION), np.random.default_rng(2)
    speed = np.hypot(*velocity_px_s.T)
    seen_px_s = np.where((sent > 0)[:, None], velocity_px_s, 0.0)  # a fit of nothing rests
    for _ in range(steps):
        events = rng.poisson((sent * share * EVENTS_PER_PX * speed + NOISE_HZ) * DT_S)
        listen(manager, seen_px_s, events, share)
    return manager


def test_doubt_needs_patience() -> None:
    manager = TrackManager(CALIBRATION)
    for t_us, held in ((0, False), (10_000, False), (20_000, True)):
        manager.update(t_us, fits(REST_PX, doubtful()), BLIND)
        assert manager.coasted[CENTRE] == held
    assert manager.coasted.sum() == 1


def test_a_lost_marker_is_predicted_from_its_neighbours() -> None:
    manager = lost()
    moved_px = REST_PX + np.array([5.0, -3.0])
    fitted_px = moved_px.copy()
    fitted_px[CENTRE] = REST_PX[CENTRE] + [-4.0, 7.0]
    seen = levels(np.delete(moved_px, CENTRE, axis=0))
    assert manager.update(2 * LATER_US, fits(fitted_px, doubtful()), seen)[CENTRE]
    np.testing.assert_allclose(manager.position_px[CENTRE], moved_px[CENTRE], atol=0.2)


def test_held_markers_at_a_border_do_not_run_away() -> None:
    """An affine prediction from some that are held themselves grew without end."""
    manager, fitted_px = TrackManager(CALIBRATION), REST_PX.copy()
    fitted_px[15:] += np.outer(REST_PX[15:, 1] - REST_PX[10, 1], [0.05, 0.1])
    agreement, blind = np.where(np.arange(COUNT) < 15, 0.1, 1.0), levels(REST_PX[15:])
    for t_us in range(0, 20 * LATER_US, LATER_US):
        manager.update(t_us, fits(fitted_px, agreement), blind)
    away_px = np.abs(manager.position_px[:15] - REST_PX[:15])
    assert away_px.max() <= np.abs(fitted_px - REST_PX).max()


def test_a_marker_that_reappears_near_its_prediction_is_found_again() -> None:
    manager, back_px = lost(), REST_PX.copy()
    back_px[CENTRE] += [3.0, 2.0]
    manager.update(LATER_US + 20_000, fits(REST_PX, doubtful()), levels(back_px))
    assert not manager.coasted.any()
    np.testing.assert_allclose(manager.position_px[CENTRE], back_px[CENTRE], atol=0.2)


def test_a_silent_marker_comes_back_with_events_only() -> None:
    sent = np.ones(COUNT)
    sent[CENTRE] = 0.0
    manager, events = heard(moving(60.0), sent), np.zeros(COUNT, np.int64)
    for t_us in range(0, 4 * LATER_US, LATER_US):
        manager.update(t_us, fits(REST_PX, AGREED), levels(REST_PX))
        assert manager.coasted[CENTRE], "nothing tells that it is more than paint"
    events[CENTRE] = 400
    listen(manager, np.zeros((COUNT, 2)), events)
    manager.update(9 * LATER_US, fits(REST_PX, AGREED), levels(REST_PX))
    assert not manager.coasted.any()


@pytest.mark.parametrize("beside_px", [(0.5 * PITCH_PX, 0.0), (PITCH_PX, 0.0)])
def test_another_blob_is_not_a_marker_that_came_back(beside_px: tuple[float, float]) -> None:
    """Half a pitch away it might be a reflection; a pitch away it is a neighbour's."""
    manager, stray_px = lost(), REST_PX.copy()
    stray_px[CENTRE] += beside_px
    for t_us in (LATER_US + 20_000, LATER_US + 40_000):
        manager.update(t_us, fits(REST_PX, doubtful()), levels(stray_px))
    assert np.flatnonzero(manager.coasted).tolist() == [CENTRE]
    np.testing.assert_allclose(manager.position_px[CENTRE], REST_PX[CENTRE], atol=0.2)


def test_a_runaway_is_noticed_by_its_neighbours() -> None:
    manager, fitted_px = TrackManager(CALIBRATION), REST_PX.copy()
    fitted_px[CENTRE] += [14.0, 0.0]
    for t_us in (0, LATER_US):
        manager.update(t_us, fits(fitted_px, AGREED), levels(REST_PX))
    assert not manager.coasted.any(), "it was found again where it belongs"
    np.testing.assert_allclose(manager.position_px[CENTRE], REST_PX[CENTRE], atol=0.2)


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("gone", [(CENTRE,), (CENTRE, 13), (6, 18)])
def test_markers_that_are_gone_are_found(gone: tuple[int, ...], share: float) -> None:
    sent = np.ones(COUNT)
    sent[list(gone)] = 0.0
    manager = heard(moving(60.0), sent, share)
    assert np.flatnonzero(manager.silent).tolist() == sorted(gone)
    confidence = manager.confidence(fits(REST_PX, AGREED), DT_S, silent=False)
    assert (np.flatnonzero(confidence < 0.5) == sorted(gone)).all()
    manager.update(0, fits(REST_PX, AGREED), levels(REST_PX))
    assert np.flatnonzero(manager.coasted).tolist() == sorted(gone), "at once, and not found"


def test_a_silence_takes_confidence_that_motion_gives_back() -> None:
    manager, agreement = TrackManager(CALIBRATION), np.linspace(0.5, 1.0, COUNT)
    resting, moving_on = fits(REST_PX, agreement), fits(REST_PX, agreement)
    moving_on["vx"][::2] = 100.0
    manager.confidence(resting, 0.07, silent=True)
    np.testing.assert_allclose(manager.confidence(resting, 0.03, True), agreement * np.exp(-1.0))
    np.testing.assert_allclose(manager.confidence(resting, 9.0, False), agreement * np.exp(-1.0))
    left = (1.0 - np.exp(-1.0)) * np.where(np.arange(COUNT) % 2, 1.0, np.exp(-0.6))
    got = manager.confidence(moving_on, 0.03, silent=False)
    np.testing.assert_allclose(got, agreement * (1.0 - left))


@pytest.mark.parametrize(("noise_per_s", "silences"), [(20_000, 1), (0, 0)])
def test_only_a_stream_with_noise_can_have_gaps(noise_per_s: int, silences: int) -> None:
    """Where there is none, creep and silence alternate."""
    rng, count = np.random.default_rng(1), max(noise_per_s, 50)
    t = np.sort(rng.integers(0, 1_000_000, count))
    x, y = rng.integers(0, SIZE, (count, 2)).T
    if not noise_per_s:
        x, y = (REST_PX[rng.integers(0, COUNT, count)] + [6.0, 0.0]).astype(int).T
    keep = (t < 600_000) | (t >= 650_000)
    events = packet_of(t[keep], x[keep], y[keep], rng.random(keep.sum()) < 0.5, SIZE)
    tracker, least = GradedTracker(GradedTrackerConfig(), CALIBRATION), []
    for window in windows([events], 1_000):
        tracker.absorb(window)
        least.append(tracker.estimate(window.t_end_us).confidence.min())
    assert tracker.silences == silences
    assert (min(least) < 0.8) == bool(silences)


def test_those_that_send_or_need_not_are_left_alone() -> None:
    half = np.ones(COUNT)
    half[CENTRE] = 0.55
    away = REST_PX - REST_PX[CENTRE]
    spin = 2.0 * np.stack([-away[:, 1], away[:, 0]], axis=1)
    rim = np.zeros((COUNT, 2))
    rim[[6, 7, 8, 11, 12, 13, 16, 17, 18]] = (80.0, 0.0)  # the inner nine are dragged
    for velocity, sent in ((moving(60.0), half), (spin, np.ones(COUNT)), (rim, np.ones(COUNT))):
        assert not heard(velocity, sent, steps=300).silent.any()
    assert not heard(moving(4.0), np.zeros(COUNT), steps=1_000).silent.any(), "creep"


def test_held_neighbours_do_not_keep_each_other_silent() -> None:
    """All four in the middle were held: none of their neighbours' motion asked for events."""
    manager, velocity = TrackManager(CALIBRATION), moving(60.0)
    gone = [6, 7, 11, 12]
    manager.silent[gone], manager._cusum_px[gone] = True, 4.0
    velocity[gone] = 0.0
    for _ in range(150):
        listen(manager, velocity, (EVENTS_PER_PX * 60.0 * DT_S).astype(np.int64))
    assert not manager.silent.any()


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    rng = np.random.default_rng(7)
    index = np.array([rng.permutation(COUNT)[:8] for _ in range(COUNT)])
    weight, surrounded = rng.dirichlet(np.ones(8), COUNT), rng.random(COUNT) < 0.8
    noise, full = rng.uniform(0, 900, COUNT), 0.4 * EVENTS_PER_PX
    got = np.zeros(COUNT), np.zeros(COUNT, np.bool_)
    unheard, silent = np.zeros(COUNT), np.zeros(COUNT, np.bool_)
    for _ in range(200):
        velocity = rng.normal(0, 120, (COUNT, 2))
        events = rng.poisson(np.linspace(0.0, 5.0, COUNT))
        cells = index, weight, surrounded, events, noise
        track_management.silence_kernel(
            moving_markers(REST_PX, velocity), *cells, 2.0 * full, 0.5, DT_S, *got
        )
        third = np.sort(np.hypot(*velocity.T)[index], axis=1)[:, 2]
        asked = np.minimum(
            third, np.linalg.norm((weight[:, :, None] * velocity[index]).sum(1), axis=1)
        )
        told = (asked > 10.0) & (asked < 400.0) & (asked * full > 1.5 * noise)
        clear = events > noise * DT_S + 3.0 * np.sqrt(noise * DT_S + 1.0)
        sent = (events - noise * DT_S) / full
        summed = np.clip(unheard + told * asked * DT_S - sent / 0.35, 0.0, 4.0)
        unheard = np.where(told | clear, summed, unheard)
        limit = np.where(silent, 1.0, 2.0)
        silent = np.where(told | clear, surrounded & (unheard > limit), silent)
    np.testing.assert_allclose(got[0], unheard)
    np.testing.assert_array_equal(got[1], silent)
    assert 0 < silent.sum() < COUNT


@pytest.mark.parametrize("lost_share", [0.9, 1.0])
def test_a_skin_whose_release_lost_its_events_is_put_back(lost_share: float) -> None:
    """It is by the few that are left, or by those of the next contact."""
    knots_ms, knots_px = [100, 200, 250, 258, 600, 650], [0.0, 10.0, 10.0, 0.0, 0.0, 3.0]
    way_px = np.interp(np.arange(750), knots_ms, knots_px)
    events = ideal_events(REST_PX + np.multiply.outer(way_px, [[1.0, 0.0]]), 6.0, SIZE)
    seen = np.random.default_rng(3).random(len(events)) >= lost_share
    kept = (events.t < 250_000) | (events.t > 260_000) | seen
    tracker, off_px = GradedTracker(GradedTrackerConfig(), CALIBRATION), []
    for window in windows([events.select(kept)], 1_000):
        tracker.absorb(window)
        moved_px = tracker.estimate(window.t_end_us).displacement_px[:, 0]
        off_px.append(np.abs(moved_px - way_px[window.t_start_us // 1_000]).max())
    assert (max(off_px[300:600]) < 1.0) == (lost_share < 1.0)
    assert off_px[260] > 5.0
    assert max(off_px[700:]) < 1.0


@pytest.mark.parametrize(("hit", "recovery_s"), [(COUNT, None), (3, None), (COUNT, 0.2)])
def test_trails_of_a_fast_hit_are_no_release_but_new_light_is(
    hit: int, recovery_s: float | None
) -> None:
    skin = MisplacedSkin(replace(CALIBRATION, recovery_s=recovery_s))
    rng = np.random.default_rng(1)
    hit_px = REST_PX + np.multiply.outer(np.arange(COUNT) < hit, [12.0, 0.0])

    def is_released(place_px: np.ndarray, light: float) -> bool:
        shown = np.maximum(levels(place_px), light * levels(REST_PX))
        state_map = GradedStateMap(shown + rng.normal(0.0, 0.02, SIZE[::-1]))
        state_map.pixels["marker"] = COUNT
        markers, nothing = moving_markers(place_px), np.zeros(COUNT + 1)
        markers["radius_px"] = RADIUS_PX
        return skin.update(markers, state_map, nothing, DT_S, nothing)

    assert not is_released(REST_PX, 0.0)
    assert not is_released(hit_px, 0.2)
    assert not is_released(hit_px, 0.2)
    # Pixels that recover lighten by themselves.
    assert is_released(hit_px, 0.6) == (recovery_s is None)


def test_the_rise_of_the_light_at_the_rests_equals_its_twin() -> None:
    rng, place_px = np.random.default_rng(2), REST_PX + np.array([8.0, -3.0])
    pixels, values = np.zeros(SIZE, PIXEL), rng.random(SIZE)
    pixels["marker"] = np.where(rng.random(SIZE) < 0.8, COUNT, CENTRE)
    markers = moving_markers(place_px, np.tile([3.0, 4.0], (COUNT, 1)))
    markers["radius_px"] = RADIUS_PX
    light = np.where(np.arange(COUNT) % 5, rng.random(COUNT), np.nan)
    before, rises = light.copy(), np.full(COUNT, np.nan)
    for m, (place, way) in enumerate(zip(place_px, REST_PX - place_px, strict=True)):
        along, contrasts = way / np.hypot(*way), []
        for s, aside in product(range(6 + 3, int(np.hypot(*way) + 6.0)), (-3.0, 0.0, 3.0)):
            point = np.rint(place + s * along + aside * np.array([-along[1], along[0]]))
            x, y = np.array([point, np.rint(2.0 * place - point)], int).T
            inside = (np.stack([x, y]) >= 0).all() and (np.stack([x, y]) < SIZE[0]).all()
            if inside and np.isin(pixels["marker"][y, x], (m, COUNT)).all():
                contrasts.append(values[y[0], x[0]] - values[y[1], x[1]])
        if len(contrasts) >= 2:
            rises[m] = np.mean(contrasts) - np.nan_to_num(before[m])
    seen = ~np.isnan(rises + before)
    error = np.std(rises[seen]) / np.sqrt(np.count_nonzero(seen) - 1.0)
    got = light_rise_kernel(values, pixels, REST_PX, markers, light, 0.25)
    assert got == pytest.approx((np.mean(rises[seen]), error))
    learned = np.where(np.isnan(before), rises, before + 0.25 * np.nan_to_num(rises))
    np.testing.assert_allclose(light, learned)
    assert mean_motion_kernel(REST_PX, markers) == pytest.approx((np.hypot(8.0, 3.0), 5.0))


def test_events_on_the_rims_equal_their_twin() -> None:
    rng, place_px, pixels = (
        np.random.default_rng(2),
        REST_PX + np.array([5.0, -3.0]),
        np.zeros(SIZE, PIXEL),
    )
    pixels["events"], pixels["alone"][::7] = rng.integers(0, 9, SIZE), HOT
    angle, off = np.meshgrid(np.arange(8) * np.pi / 4.0, 6.0 + np.arange(-2, 3, 2))
    circle_px = np.stack([off * np.cos(angle), off * np.sin(angle)], -1).reshape(-1, 2)

    def seen(here: np.ndarray, other: np.ndarray) -> int:
        point = np.rint(here + circle_px)[(np.abs(here + circle_px - 104.5) < 105.0).all(axis=1)]
        single = np.abs(np.hypot(*(point - other).T) - 6.0) > 2.5
        chosen = pixels[tuple(point[single].astype(int).T[::-1])]
        return int(chosen["events"][chosen["alone"] != HOT].sum())

    expected = [sum(map(seen, *both)) for both in ((REST_PX, place_px), (place_px, REST_PX))]
    markers = moving_markers(place_px)
    markers["radius_px"] = RADIUS_PX
    assert rim_events_kernel(pixels, REST_PX, markers) == tuple(expected)
