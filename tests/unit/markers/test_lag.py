"""Lag and dead time from events: of low-pass pixels, and of cameras whose delays are known."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.events.windows import windows
from spikingtac.markers import crossings as crossings_module
from spikingtac.markers import lag
from spikingtac.markers.crossings import (
    ORDERS,
    PERIOD_US,
    PLACE_BINS,
    REACH_PX,
    SPEED_EDGES_PX_S,
    Crossings,
    MarkerTrack,
    crossings,
    edge_track,
)
from spikingtac.markers.lag import (
    DARK_SHARE,
    estimate_dead_time,
    estimate_lag,
    slowness,
    with_delays,
)
from spikingtac.sim.camera.config import load_camera
from spikingtac.sim.camera.event_camera import EventCamera
from spikingtac.sim.optics import MarkerImage
from spikingtac.types import EventPacket, MarkerFrame

EDGE = DiscProfile(6.0, 0.5)
# The twin's edge: sqrt(0.5^2 + 1/12) px Gaussian, as the nearest logistic.
TWINS_EDGE = DiscProfile(6.0, 0.577 / 1.702)
STEP_PX = 2e-3
WAY_PX = np.arange(-7.0, 12.0, STEP_PX)  # of the edge past a pixel
LEVELS = np.array([0.2, 0.35, 0.5, 0.65, 0.8])


def late_px(brightening: bool, kappa_px: np.ndarray, dark: float) -> np.ndarray:
    """Return ``(n, k)`` how far past a level's place an edge is when a low-pass pixel reports it.

    Euler's method on dv/dt = (L - v) / tau, for n products of speed and tau at white, px.
    """
    level = EDGE.level(-WAY_PX if brightening else WAY_PX)
    rate = STEP_PX / (kappa_px[:, np.newaxis] * slowness(EDGE, level, dark))
    seen = np.empty_like(rate)
    seen[:, 0] = level[0]
    for i in range(1, len(WAY_PX)):
        before = seen[:, i - 1]
        seen[:, i] = before + (level[i] - before) * np.minimum(rate[:, i], 1.0)
    crossed = [[np.argmax((row >= one) == brightening) for one in LEVELS] for row in seen]
    at_rest = [np.argmax((level >= one) == brightening) for one in LEVELS]
    return WAY_PX[np.array(crossed)] - WAY_PX[at_rest]


def modelled(lag_s: float, white_s: float, dark: float, skew_s: float = 0.0) -> Crossings:
    """Crossings of an ideal ladder whose positions are late by ``lag_s``."""
    speeds = 0.5 * (SPEED_EDGES_PX_S[:-1] + SPEED_EDGES_PX_S[1:])
    count = np.zeros((2, ORDERS, len(speeds), PLACE_BINS), np.int64)
    rng = np.random.default_rng(0)
    for side in (0, 1):
        late = late_px(side == 0, speeds * white_s, dark)
        late += (-lag_s + (2 * side - 1) * skew_s) * speeds[:, None]
        for order, level in enumerate(LEVELS if side == 0 else LEVELS[::-1]):
            column = order if side == 0 else len(LEVELS) - 1 - order
            q = np.interp(-level, -EDGE.level(WAY_PX), WAY_PX) + (2 * side - 1) * late[:, column]
            for bin_, middle in enumerate(q):
                drawn = middle + rng.normal(0.0, 0.2, 4_000)
                places = ((drawn + REACH_PX) / (2 * REACH_PX) * PLACE_BINS).astype(int)
                count[side, order, bin_] = np.bincount(places, minlength=PLACE_BINS)
    return count, speeds


def spread_us(estimate: tuple[float, float]) -> float:
    """Return the standard deviation without that of the dark current."""
    return float(np.sqrt(estimate[1] ** 2 - (DARK_SHARE * estimate[0]) ** 2))


@pytest.mark.parametrize("white_us", [150.0, 800.0, 2_000.0])
@pytest.mark.parametrize("skew_us", [0.0, 300.0])
def test_the_lag_of_low_pass_pixels_is_solved(white_us: float, skew_us: float) -> None:
    lag_us = 2.2 * white_us
    found = modelled(lag_us * 1e-6, white_us * 1e-6, 0.06, skew_us * 1e-6)
    estimate = estimate_lag(found, EDGE)
    assert estimate is not None
    # A pixel falls behind by less than in proportion to the speed.
    assert estimate[0] == pytest.approx(lag_us, abs=3 * estimate[1], rel=0.12)
    assert spread_us(estimate) < 0.08 * lag_us + 100.0


def roughened(found: Crossings, spread_px: float, seed: int) -> Crossings:
    """Move the events of each rung and speed by an amount that no model explains."""
    rng, count = np.random.default_rng(seed), found[0].copy()
    bins = np.rint(rng.normal(0.0, spread_px, count.shape[:3]) * PLACE_BINS / (2 * REACH_PX))
    for place in np.ndindex(*bins.shape):
        count[place] = np.roll(count[place], int(bins[place]))
    return count, found[1]


def test_places_that_do_not_fit_the_model_widen_the_uncertainty() -> None:
    lag_us = 2_000.0
    smooth = modelled(lag_us * 1e-6, 8e-4, 0.06)
    stated = estimate_lag(smooth, EDGE)
    assert stated is not None
    for seed in range(5):
        rough = estimate_lag(roughened(smooth, 0.06, seed), EDGE)
        assert rough is not None
        assert spread_us(rough) > 1.5 * spread_us(stated)
        assert abs(rough[0] - lag_us) < 3.0 * rough[1]


def slides(amplitude_px: float = 16.0, duration_ms: int = 350) -> np.ndarray:
    """Return displacements at 1 kHz: out and back along x and y, both ways round."""
    share = (np.arange(duration_ms) + 1.0) / duration_ms
    out = (share**3 * (10 + share * (6 * share - 15)))[:, None] * amplitude_px
    pause = np.zeros((60, 2))
    parts = [pause]
    for heading in 2 * ((1.0, 0.05), (-1.0, 0.0), (0.03, -1.0), (-0.02, 1.0)):
        parts += [out * heading, (amplitude_px - out) * heading, pause]
    return np.concatenate(parts)


@cache
def filmed(
    preset: str, bandwidth_hz: float, dead_us: float | None = None
) -> tuple[EventPacket, np.ndarray, np.ndarray]:
    """Return the twin's events of 16 discs that slide, their true paths and their radii."""
    base = load_camera(preset)
    pixel = replace(base.pixel, bandwidth_hz=bandwidth_hz)
    if dead_us is not None:
        pixel = replace(pixel, refractory_us=dead_us)
    camera = replace(base, pixel=pixel)
    place = np.arange(4) * 37.0 + 18.6
    rest = np.stack(np.meshgrid(place, place), -1).reshape(-1, 2)
    rest += np.random.default_rng(1).uniform(-0.8, 0.8, rest.shape)
    radius, shape = np.full(16, 7.0), np.tile(np.eye(2), (16, 1, 1))
    path = rest + slides()[:, None]
    images = [MarkerImage(1_000 * i, at, shape, radius) for i, at in enumerate(path)]
    lens = EventCamera(camera, (150, 150), seed=3)
    lens.settle(images[0], "random")
    return lens.advance(images[1:]), path, radius


def delayed(path: np.ndarray, lag_us: float) -> MarkerTrack:
    t_us = np.arange(len(path)) * 1_000
    flat = path.reshape(len(path), -1)
    late = [np.interp(t_us - lag_us, t_us, column) for column in flat.T]
    places = np.stack(late, axis=1).reshape(path.shape)
    return MarkerTrack(t_us, places, np.full(path.shape[1], 7.0), 1.0)


@pytest.mark.parametrize(
    ("preset", "bandwidth_hz"), [("typical", 2_000.0), ("noisy", 500.0), ("typical", 150.0)]
)
def test_the_twins_lag_is_found(preset: str, bandwidth_hz: float) -> None:
    """The twin's pixels are late by (tau + latency) at white over the light; so is the track."""
    packet, path, _ = filmed(preset, bandwidth_hz)
    white_us = 1e6 / (2 * np.pi * bandwidth_hz) + 150.0
    middle_us = white_us * 6.0**0.5
    found = crossings([packet], delayed(path, middle_us), packet.size)
    estimate = estimate_lag(found, TWINS_EDGE)
    assert estimate is not None
    assert estimate[0] == pytest.approx(middle_us, rel=0.2, abs=200.0)
    assert abs(estimate[0] - middle_us) < 2.0 * estimate[1]


@pytest.mark.parametrize(("preset", "dead_us"), [("typical", 500.0), ("noisy", 1_000.0)])
def test_a_long_dead_time_is_found(
    preset: str, dead_us: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    packet, path, _ = filmed(preset, 1_000.0, dead_us)
    found = crossings([packet], delayed(path, 0.0), packet.size)
    assert estimate_dead_time(found, TWINS_EDGE) == pytest.approx(dead_us, rel=0.25)
    monkeypatch.setattr(lag, "LARGEST_DEAD_US", 0.5 * dead_us)
    assert estimate_dead_time(found, TWINS_EDGE) is None, "more than any camera has"


def test_a_usual_dead_time_is_not_told() -> None:
    packet, path, _ = filmed("noisy", 1_000.0, 100.0)
    found = crossings([packet], delayed(path, 0.0), packet.size)
    assert estimate_dead_time(found, TWINS_EDGE) is None


def test_what_tells_too_little_gives_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    size = 112, 112
    silence = [EventPacket.empty(0, 1_000_000, size)]
    quiet = crossings(silence, delayed(np.zeros((900, 1, 2)), 0.0), size)
    assert estimate_lag(quiet, EDGE) is estimate_dead_time(quiet, EDGE) is None
    found = modelled(2e-3, 8e-4, 0.06)
    monkeypatch.setattr(lag, "LARGEST_ERROR_US", 50.0)
    monkeypatch.setattr(lag, "LARGEST_ERROR_SHARE", 0.01)
    assert estimate_lag(found, EDGE) is None, "a measurement that is worse than a guess"
    monkeypatch.undo()
    found[0][1] = 0
    assert estimate_lag(found, EDGE) is None, "one polarity alone"


def late_frames(source: PacketSource, path: np.ndarray, lag_us: float) -> Iterator[MarkerFrame]:
    """Yield a known path, late; its first marker is held, and wrong."""
    track = delayed(path, lag_us)
    for window in windows(source, PERIOD_US):
        row = min(int(np.searchsorted(track.t_us, window.t_end_us)), len(track.t_us) - 1)
        at = track.center_px[row].copy()
        held = np.arange(len(at)) == 0
        at[held] += 1.0
        yield MarkerFrame(window.t_end_us, at, at, at, held, np.ones(len(at)))


def test_a_recording_is_tracked_and_its_lag_found_by_all_markers_or_a_part_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    packet, path, radius = filmed("typical", 500.0)
    plain = Calibration(reference_px=path[0], radius_px=radius, grid=(4, 4), size=packet.size)
    known = replace(plain, contrast=6.0, edge_px=0.577 / 1.702)
    source, lag_us = PacketSource([packet], packet.size), 1_147.0
    assert with_delays(source, plain) is plain, "the edge is not known"
    samples = []
    for most in (128, 8):
        monkeypatch.setattr(crossings_module, "MOST_MARKERS", most)
        track = edge_track(late_frames(source, path, lag_us), known)
        found = crossings(source, track, packet.size)
        estimate = estimate_lag(found, TWINS_EDGE) or (0.0, 0.0)
        assert estimate[0] == pytest.approx(lag_us, rel=0.2)
        samples.append(found[0].sum())
    assert 0.2 < samples[1] / samples[0] < 0.7
