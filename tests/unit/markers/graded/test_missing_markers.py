from __future__ import annotations

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded import missing_markers as silence
from spikingtac.markers.graded.event_loss import CellCounts
from spikingtac.markers.graded.missing_markers import MissingMarkers
from spikingtac.markers.neighbours import Neighbourhood

GRID = (5, 5)
COUNT = 25
REFERENCE_PX = 30.0 + 40.0 * np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), -1).reshape(
    -1, 2
)
CALIBRATION = Calibration(
    reference_px=REFERENCE_PX, radius_px=np.full(COUNT, 7.0), grid=GRID, size=(220, 220)
)
EVENTS_PER_PX = np.full(COUNT, 170.0)
NOISE_PER_S = np.full(COUNT, 300.0)
DT_S = 1e-3
CENTRE, CORNER = 12, 0


def watch(
    velocity_px_s: np.ndarray, sent: np.ndarray, share: float = 1.0, steps: int = 300
) -> np.ndarray:
    """Let every marker send a share of what its own motion asks for."""
    judge, rng = MissingMarkers(CALIBRATION), np.random.default_rng(2)
    speed = np.hypot(*velocity_px_s.T)
    seen_px_s = np.where((sent > 0)[:, None], velocity_px_s, 0.0)  # a fit of nothing rests
    for _ in range(steps):
        events = rng.poisson((sent * share * EVENTS_PER_PX * speed + NOISE_PER_S) * DT_S)
        judge.update(seen_px_s, CellCounts(events, NOISE_PER_S, EVENTS_PER_PX, DT_S), share)
    return judge.silent


def moving(speed_px_s: float) -> np.ndarray:
    return np.tile([0.6 * speed_px_s, 0.8 * speed_px_s], (COUNT, 1))


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("gone", [(CENTRE,), (CENTRE, 13), (6, 18)])
def test_markers_that_are_gone_are_found(gone: tuple[int, ...], share: float) -> None:
    sent = np.ones(COUNT)
    sent[list(gone)] = 0.0
    assert np.flatnonzero(watch(moving(60.0), sent, share)).tolist() == sorted(gone)


def test_the_border_is_not_judged() -> None:
    """Motion dies away towards it: a resting corner beside moving neighbours is no lost one."""
    sent = np.ones(COUNT)
    sent[[CORNER, 2]] = 0.0
    assert not watch(moving(60.0), sent).any()


def test_half_a_disc_is_still_a_marker() -> None:
    sent = np.ones(COUNT)
    sent[CENTRE] = 0.55
    assert not watch(moving(60.0), sent).any()


def test_rest_and_creep_accuse_nobody() -> None:
    assert not watch(moving(4.0), np.zeros(COUNT), steps=2_000).any()


def test_the_centre_of_a_rotation_may_rest() -> None:
    away = REFERENCE_PX - REFERENCE_PX[CENTRE]
    spin = 2.0 * np.stack([-away[:, 1], away[:, 0]], axis=1)
    assert not watch(spin, np.ones(COUNT)).any()


def test_the_rim_of_a_touch_may_rest() -> None:
    velocity = np.zeros((COUNT, 2))
    velocity[[6, 7, 8, 11, 12, 13, 16, 17, 18]] = (80.0, 0.0)  # the inner nine are dragged
    assert not watch(velocity, np.ones(COUNT)).any()


def test_a_marker_that_sends_again_is_heard() -> None:
    judge, velocity = MissingMarkers(CALIBRATION), moving(60.0)
    for sends, expected in ((0.0, True), (1.0, False)):
        events = (EVENTS_PER_PX * 60.0 * DT_S).astype(np.int64)
        events[CENTRE] *= sends
        for _ in range(400):
            cells = CellCounts(events, np.zeros(COUNT), EVENTS_PER_PX, DT_S)
            judge.update(velocity, cells, 1.0)
        assert judge.silent[CENTRE] == expected


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    rng = np.random.default_rng(4)
    neighbours = np.array([rng.permutation(COUNT)[:8] for _ in range(COUNT)])
    velocity, expected = rng.normal(0, 50, (2, COUNT, 2))
    got = silence._asked_speed_kernel(velocity, expected, neighbours)
    third = np.sort(np.hypot(*velocity.T)[neighbours], axis=1)[:, silence.RESTING_NEIGHBOURS]
    np.testing.assert_allclose(got, np.minimum(third, np.hypot(*expected.T)))


def test_the_neighbours_velocity_is_that_of_their_affine_motion() -> None:
    rng = np.random.default_rng(6)
    neighbours = Neighbourhood(REFERENCE_PX)
    velocity = rng.normal(0, 50, (COUNT, 2))
    got = silence._expected_velocity_kernel(velocity, neighbours.index, neighbours.weight)
    np.testing.assert_allclose(got, neighbours.expected_px(REFERENCE_PX + velocity) - REFERENCE_PX)


def plainly_judged(
    speed: np.ndarray, cells: tuple[np.ndarray, ...], share: float, state: list[np.ndarray]
) -> None:
    events, noise, per_px = cells
    asked, arrived, silent = state
    for m in range(COUNT):
        full = share * per_px[m]
        if speed[m] > 10.0 and full * speed[m] > 1.5 * noise[m]:
            kept = max(1.0 - speed[m] * DT_S / silence.MEMORY_TRAVEL_PX, 0.0)
            asked[m] = kept * asked[m] + full * speed[m] * DT_S
            arrived[m] = kept * arrived[m] + events[m] - noise[m] * DT_S
            if asked[m] > silence.LEAST_TRAVEL_PX * full:
                silent[m] = arrived[m] / asked[m] < (0.5 if silent[m] else 0.2)


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_the_watch_does_what_its_plain_twin_does(share: float) -> None:
    rng = np.random.default_rng(7)
    neighbours = Neighbourhood(REFERENCE_PX)
    surrounded = rng.random(COUNT) < 0.8
    got, plain = ([np.zeros(COUNT), np.zeros(COUNT), np.zeros(COUNT, np.bool_)] for _ in range(2))
    for _ in range(200):
        velocity = rng.normal(0, 120, (COUNT, 2))
        expected = neighbours.expected_px(REFERENCE_PX + velocity) - REFERENCE_PX
        speed = silence._asked_speed_kernel(velocity, expected, neighbours.index) * surrounded
        events = rng.poisson(np.linspace(0.0, 12.0 * share, COUNT))
        cells = events, rng.uniform(0, 900, COUNT), EVENTS_PER_PX
        plainly_judged(speed, cells, share, plain)
        silence._watch_kernel(
            velocity,
            neighbours.index,
            neighbours.weight,
            surrounded,
            *cells,
            share,
            DT_S,
            *got,
        )
    np.testing.assert_allclose(got[0], plain[0])
    np.testing.assert_allclose(got[1], plain[1], atol=1e-9)
    np.testing.assert_array_equal(got[2], plain[2])
    assert 0 < plain[2].sum() < COUNT
