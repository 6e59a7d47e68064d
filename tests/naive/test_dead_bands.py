"""The fit to dead bands against a plain twin, and on presses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spikingtac.config import load_config
from spikingtac.markers.graded.appearance import fit_window
from spikingtac.markers.graded.dead_bands import (
    BAND_WEIGHT,
    GAIN,
    OUTLINE_PRIOR,
    PRIOR_WEIGHT,
    SOFT_RESIDUAL,
    fit_bands_kernel,
)
from spikingtac.markers.graded.disc_fit import fit_scratch
from spikingtac.markers.registry import MarkerTracker, make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.types import EventPacket
from stand_ins.random_packets import cut_at
from stand_ins.rare_off import (
    PERIOD_US,
    PROFILE,
    RADIUS_PX,
    REST_PX,
    SIZE,
    STEP_OFF,
    STEP_ON,
    levels,
    presses_px,
    rare_off_calibration,
    rare_off_events,
)

OUTLINE = RADIUS_PX + 0.2, 0.3, -0.2
WINDOW = fit_window(PROFILE, SIZE[0], 16.0)
INNER_PX, OUTER_PX = (float(end) for end in WINDOW.edge[0, :2])


def random_map(seed: int) -> GradedStateMap:
    """Return levels near those of resting discs, of which a third are new."""
    rng, shape = np.random.default_rng(seed), (SIZE[1], SIZE[0])
    painted = levels(REST_PX).astype(np.float32)
    state_map = GradedStateMap(painted, STEP_ON, STEP_OFF, lead_steps=0.0)
    state_map.pixels["level"] = painted + rng.normal(0.0, 0.2, shape)
    new = rng.random(shape) < 0.3
    state_map.values[new] = state_map.pixels["level"][new]
    return state_map


def fitted(state_map: GradedStateMap, *disc: Any) -> tuple[float, float, float, float]:
    """Return what the kernel fits to a map, from a place, an outline and settings."""
    maps = state_map.pixels, (state_map.padded.ravel(), *SIZE), fit_scratch(20.0)
    return fit_bands_kernel(*maps, WINDOW, 0, *disc)


class Twin:
    """Residuals of a disc's pixels from the formulas alone."""

    def __init__(self, state_map: GradedStateMap, x: float, y: float, signal: float = 1.0) -> None:
        row, column = np.mgrid[: SIZE[1], : SIZE[0]]
        dx, dy = column - x, row - y
        rho = np.hypot(dx, dy) + 1e-9
        self.x, self.y = dx / rho, dy / rho
        self.even, self.odd = self.x**2 - self.y**2, 2.0 * self.x * self.y
        q = rho - OUTLINE[0] - OUTLINE[1] * self.even - OUTLINE[2] * self.odd
        # A ring is read that holds the edge and little more.
        self.near, self.far = (q > INNER_PX) & (q < OUTER_PX), np.abs(q) > OUTER_PX - INNER_PX
        self.disc = PROFILE.level(np.clip(q, INNER_PX, OUTER_PX))
        self.slope = np.where(self.near, -PROFILE.slope(q), 0.0)
        apart = state_map.pixels["level"] - self.disc
        outside = np.where(apart > STEP_OFF, apart - STEP_OFF, np.minimum(apart + STEP_ON, 0.0))
        self.new = state_map.values == state_map.pixels["level"]
        self.e = np.where(self.new, apart, outside)
        self.soft = 1.0 / (1.0 + (self.e / SOFT_RESIDUAL) ** 2)
        self.weight = np.where(self.new, signal, BAND_WEIGHT) * self.soft * (self.e != 0.0)


def plain_place(state_map: GradedStateMap, x: float, y: float, signal: float) -> np.ndarray:
    """Return the place after all Gauss-Newton steps from a prediction, px."""
    place = predicted = np.array([x, y])
    for _ in range(3):
        twin = Twin(state_map, *place, signal)
        jacobian = np.stack([twin.slope * twin.x, twin.slope * twin.y])
        curvature = np.einsum("iyx,jyx,yx->ij", jacobian, jacobian, twin.weight)
        gradient = np.einsum("iyx,yx->i", jacobian, twin.weight * twin.e)
        gradient += PRIOR_WEIGHT * (predicted - place)
        place = place + np.linalg.solve(curvature + PRIOR_WEIGHT * np.eye(2), gradient)
    return place


@pytest.mark.parametrize("signal", [1.0, 0.4])
def test_the_fit_its_corrections_and_its_outline_equal_their_twin(signal: float) -> None:
    state_map, start_map, start = random_map(3), random_map(3), (23.6, 20.3)
    expected_px = plain_place(state_map, *start, signal)
    outline_px = np.array([OUTLINE])
    x, y, agreement, _ = fitted(state_map, start, outline_px, (3, 0.1, RADIUS_PX), signal)
    np.testing.assert_allclose((x, y), expected_px, atol=0.01)
    assert np.hypot(x - start[0], y - start[1]) > 0.1
    assert 0.5 < agreement < 1.0
    twin, after = Twin(start_map, x, y, signal), state_map.pixels["level"]
    before = start_map.pixels["level"]
    undone = twin.new * (1.0 - signal) * np.clip(twin.e, -STEP_OFF, STEP_ON)
    corrected = before - np.where(twin.new, signal, 1.0) * GAIN * twin.e * twin.soft - undone
    np.testing.assert_allclose(after[twin.near], corrected[twin.near], atol=0.02)
    np.testing.assert_array_equal(after[twin.far], before[twin.far])
    pull = twin.weight * twin.slope * twin.e
    step = 0.1 / (OUTLINE_PRIOR + (twin.weight * twin.slope**2).sum())
    moves = (pull.sum(), 2.0 * (pull * twin.even).sum(), 2.0 * (pull * twin.odd).sum())
    np.testing.assert_allclose(outline_px[0], OUTLINE + step * np.array(moves), atol=2e-3)


def test_after_a_fit_the_disc_is_shown_within_the_bands_and_no_level_is_new() -> None:
    state_map = random_map(4)
    x, y, *_ = fitted(state_map, (24.0, 20.0), np.array([OUTLINE]), (3, 0.0, RADIUS_PX), 1.0)
    above = (state_map.values - state_map.pixels["level"])[Twin(state_map, x, y).near]
    assert (above >= -STEP_OFF - 1e-6).all()
    assert (above <= STEP_ON + 1e-6).all()
    assert (above != 0.0).all()


def course(
    tracker: MarkerTracker, packet: EventPacket, cuts: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return times, us, and places, px, that a tracker finds in a stream of so many packets."""
    edges = np.linspace(0, packet.t_end_us, cuts + 1).astype(int).tolist()
    frames = list(follow(cut_at(packet, edges), tracker, 1_000.0))
    places_px = np.array([frame.detected_px for frame in frames])
    return np.array([frame.t_us for frame in frames]), places_px


def test_presses_of_a_sensor_with_rare_off_events_are_followed_however_they_are_cut() -> None:
    packet, preset = rare_off_events(), load_config("default").tracking
    bands, graded = (
        make_tracker(config, rare_off_calibration())
        for config in (preset, replace(preset, disc=replace(preset.disc, dead_bands=False)))
    )
    t_us, found_px = course(bands, packet)
    true_px = presses_px()[(t_us // PERIOD_US - 1).clip(0)]
    error_px = np.linalg.norm(found_px - true_px, axis=2)
    assert error_px.mean() < 0.2
    assert error_px.max() < 1.2
    other_px = np.linalg.norm(course(graded, packet)[1] - true_px, axis=2)
    assert error_px.mean() < 0.7 * other_px.mean()
    bands.reset()
    np.testing.assert_array_equal(course(bands, packet, cuts=37)[1], found_px)
