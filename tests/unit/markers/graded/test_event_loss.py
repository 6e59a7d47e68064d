from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded import event_loss as events_kept
from spikingtac.markers.graded.appearance import EXTRA_EVENTS
from spikingtac.markers.graded.event_loss import EventLoss

STEP = 1.0 / 7.0  # Six events of a full swing, and one step of dead band: 1 / (6 + 1).
SIZE = (320, 40)
REFERENCE_PX = np.column_stack([np.linspace(16.0, 304.0, 10), np.full(10, 20.0)])
CALIBRATION = Calibration(
    reference_px=REFERENCE_PX,
    radius_px=np.full(10, 7.0),
    grid=(1, 10),
    size=SIZE,
    step_on=STEP,
    step_off=STEP,
)
EVENTS_PER_PX = 4 * 7.0 * 6.0 * EXTRA_EVENTS
BACKGROUND_PER_MS = 20
SPEED_PX_S = 200.0
STROKE_PX = 8.0  # To and fro about the rest.
NONE = np.zeros(11, np.int64)
AREA_PX = np.append(np.full(10, 32 * 40), 0)  # Around each marker, and around none.


def motion(position_px: np.ndarray, velocity_px_s: np.ndarray | float = 0.0) -> np.ndarray:
    out = np.zeros((10, 8))
    out[:, :2], out[:, 2:4] = position_px, velocity_px_s
    return out


def watched(kept: float, moving: int = 10, seconds: float = 3.0) -> EventLoss:
    """Move some markers and lose events; return what has watched them."""
    watch, rng = EventLoss(CALIBRATION, AREA_PX), np.random.default_rng(1)
    position, velocity = REFERENCE_PX.copy(), np.zeros((10, 2))
    velocity[:moving, 0] = SPEED_PX_S
    for _ in range(500):
        background = rng.poisson(BACKGROUND_PER_MS * kept / 10, 10)
        watch.update(motion(REFERENCE_PX), np.append(background, 0), 1e-3)
        assert not watch.judged
    signal = EVENTS_PER_PX * SPEED_PX_S * 1e-3 * kept * (np.arange(10) < moving)
    for _ in range(int(seconds * 1e3)):
        counts = rng.poisson(BACKGROUND_PER_MS * kept / 10 + signal)
        position += 1e-3 * velocity
        velocity[np.abs(position[:, 0] - REFERENCE_PX[:, 0]) > STROKE_PX / 2.0] *= -1.0
        watch.update(motion(position, velocity), np.append(counts, 0), 1e-3)
    return watch


@pytest.mark.parametrize("moving", [1, 10])
def test_a_whole_stream_is_found_whole(moving: int) -> None:
    assert watched(1.0, moving).share == 1.0


@pytest.mark.parametrize("moving", [1, 10])
@pytest.mark.parametrize("kept", [0.8, 0.7, 0.5, 0.3])
def test_the_share_that_arrives_is_found(kept: float, moving: int) -> None:
    """Also where one marker moves and nine rest: a touch moves few."""
    assert watched(kept, moving).share == pytest.approx(kept, abs=0.04)


def test_snaps_creep_and_short_strokes_of_wide_edges_are_not_asked() -> None:
    for edge_px, speed_px_s, away_px in (0.5, 900, 0), (0.5, 5, 0), (1.5, 200, 2):
        watch = EventLoss(replace(CALIBRATION, edge_px=edge_px), AREA_PX)
        velocity = np.tile([speed_px_s, 0.0], (10, 1))
        for _ in range(1_000):
            watch.update(motion(REFERENCE_PX + np.array([0.0, away_px]), velocity), NONE, 1e-3)
            assert not watch.judged


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    rng = np.random.default_rng(3)
    counts = rng.poisson(50.0, 10)
    asked_once = False
    turn = REFERENCE_PX + rng.normal(0, 3, (10, 2))
    for _ in range(20):
        position = REFERENCE_PX + rng.normal(0, 8, (10, 2))
        velocity = rng.normal(0, 1, (10, 2)) * 10.0 ** rng.uniform(0, 3, (10, 1))
        noise, per_px = rng.uniform(50, 6000, 10), rng.uniform(100, 300, 10)
        dt, turned, stroke = 1e-3, turn.copy(), rng.uniform(2, 9, 10)
        moved = motion(position, velocity)
        got = events_kept.motion_kernel(moved, turned, counts, noise, per_px, stroke, dt)
        speed = np.hypot(*velocity.T)
        asked = (speed > events_kept.SLOW_PX_S) & (speed < events_kept.FAST_PX_S)
        asked &= per_px * speed > events_kept.BACKGROUND_SHARE * noise
        way = position - turn
        asked &= np.hypot(*way.T) > stroke
        turns = ((way * velocity).sum(axis=1) < 0.0) | (speed >= events_kept.FAST_PX_S)
        turn[turns] = position[turns]
        expected = (per_px * speed)[asked].sum() * dt
        arrived = (counts - noise * dt)[asked].sum()
        np.testing.assert_allclose(got, (speed.mean(), expected, arrived), rtol=1e-12)
        np.testing.assert_array_equal(turned, turn)
        asked_once = asked_once or asked.any()
    assert asked_once
