from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import Discs
from spikingtac.markers.graded import event_loss
from spikingtac.markers.graded.appearance import DEAD_US, crossing_px, events_per_px
from spikingtac.markers.graded.event_loss import EventLoss
from stand_ins.known import known, moving_markers

STEP = 1.0 / 7.0  # Six events of a full swing, and one step of dead band: 1 / (6 + 1).
SIZE = (320, 40)
REFERENCE_PX = np.column_stack([np.linspace(16.0, 304.0, 10), np.full(10, 20.0)])
CALIBRATION = known(REFERENCE_PX, 7.0, SIZE, (1, 10), STEP)
EVENTS_PER_PX = events_per_px(CALIBRATION)[0]
BACKGROUND_PER_MS = 20
SPEED_PX_S = 200.0
# Share of the calibrated events of a swing that the dead time leaves at that speed.
PER_PX_S = 1e-6 * DEAD_US / (event_loss.HALF_CROSSINGS * crossing_px(CALIBRATION)[0])
LEFT = (1.0 + event_loss.USUAL_PX_S * PER_PX_S) / (1.0 + SPEED_PX_S * PER_PX_S)
STROKE_PX = 8.0  # To and fro about the rest.
NONE = np.zeros(11, np.int64)
AREA_PX = np.append(np.full(10, 32 * 40), 0)  # In each gate, and in none.


@pytest.mark.parametrize(("polarity", "step"), [("white", 0.3), ("white", STEP), ("dark", STEP)])
def test_events_per_px_are_those_of_ideal_pixels(polarity: str, step: float) -> None:
    """Rows of pixels 0.05 px apart, each at a random threshold, are swept 30 times."""
    calibration = known(REFERENCE_PX, 7.0, SIZE, (1, 10), step, polarity=polarity)
    away_px = np.abs(np.arange(-15.0, 15.0, 0.05))
    swing = Discs.of(calibration).level(away_px[:, np.newaxis] - 7.0)[:, 0]
    reference, count = np.random.default_rng(0).uniform(-0.5, 0.5, len(swing)) * step, 0
    for turn, level in enumerate([swing, 0.0 * swing] * 30):
        events = np.fix((level - reference) / step)
        reference, count = reference + events * step, count + np.abs(events).sum() * (turn > 3)
    assert events_per_px(calibration)[0] == pytest.approx(count / 28 * 0.05, rel=0.02)


def watched(ratio: float, moving: int = 10, seconds: float = 3.0) -> EventLoss:
    """Move some markers and lose events; return the estimator after 3 s."""
    watch, rng = EventLoss(CALIBRATION, AREA_PX), np.random.default_rng(1)
    position, velocity = REFERENCE_PX.copy(), np.zeros((10, 2))
    velocity[:moving, 0] = SPEED_PX_S
    for _ in range(500):
        background = rng.poisson(BACKGROUND_PER_MS * ratio / 10, 10)
        watch.update(moving_markers(REFERENCE_PX), np.append(background, 0), 1e-3)
        assert not watch.measured
    signal = EVENTS_PER_PX * SPEED_PX_S * LEFT * 1e-3 * ratio * (np.arange(10) < moving)
    for _ in range(int(seconds * 1e3)):
        counts = rng.poisson(BACKGROUND_PER_MS * ratio / 10 + signal)
        position += 1e-3 * velocity
        velocity[np.abs(position[:, 0] - REFERENCE_PX[:, 0]) > STROKE_PX / 2.0] *= -1.0
        watch.update(moving_markers(position, velocity), np.append(counts, 0), 1e-3)
    return watch


@pytest.mark.parametrize("moving", [1, 10])
@pytest.mark.parametrize("ratio", [1.0, 0.8, 0.7, 0.5, 0.3])
def test_the_ratio_of_events_that_arrive_is_found(ratio: float, moving: int) -> None:
    """Also where one marker moves and nine rest: a touch moves few."""
    assert watched(ratio, moving).arrival_ratio == pytest.approx(ratio, abs=0.04 * (ratio < 1.0))


def test_snaps_creep_and_short_strokes_of_wide_edges_are_not_counted() -> None:
    for edge_px, speed_px_s, away_px in (0.5, 900, 0), (0.5, 5, 0), (1.5, 200, 2):
        watch = EventLoss(replace(CALIBRATION, edge_px=edge_px), AREA_PX)
        velocity = np.tile([speed_px_s, 0.0], (10, 1))
        for _ in range(1_000):
            watch.update(
                moving_markers(REFERENCE_PX + np.array([0.0, away_px]), velocity), NONE, 1e-3
            )
            assert not watch.measured


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    rng = np.random.default_rng(3)
    counts = rng.poisson(50.0, 10)
    counted_once = False
    reversal = REFERENCE_PX + rng.normal(0, 3, (10, 2))
    for _ in range(20):
        position = REFERENCE_PX + rng.normal(0, 8, (10, 2))
        velocity = rng.normal(0, 1, (10, 2)) * 10.0 ** rng.uniform(0, 3, (10, 1))
        noise, per_px = rng.uniform(50, 6000, 10), rng.uniform(100, 300, 10)
        dt, turned, stroke = 1e-3, reversal.copy(), rng.uniform(2, 9, 10)
        halving_s_px, motion = rng.uniform(0, 3e-3, 10), moving_markers(position, velocity)
        given = counts, noise, per_px, stroke, halving_s_px, dt
        got = event_loss.expected_events_kernel(motion, turned, *given)
        speed = np.hypot(*velocity.T)
        counted = (speed > event_loss.SLOW_PX_S) & (speed < event_loss.FAST_PX_S)
        counted &= per_px * speed > event_loss.BACKGROUND_SHARE * noise
        stroke_px = position - reversal
        counted &= np.hypot(*stroke_px.T) > stroke
        turns = ((stroke_px * velocity).sum(axis=1) < 0.0) | (speed >= event_loss.FAST_PX_S)
        reversal[turns] = position[turns]
        fewer = (1.0 + event_loss.USUAL_PX_S * halving_s_px) / (1.0 + speed * halving_s_px)
        expected = (per_px * speed * fewer)[counted].sum() * dt
        arrived = (counts - noise * dt)[counted].sum()
        np.testing.assert_allclose(got, (speed.mean(), expected, arrived), rtol=1e-12)
        np.testing.assert_array_equal(turned, reversal)
        counted_once = counted_once or counted.any()
    assert counted_once
