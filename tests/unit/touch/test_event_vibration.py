"""Vibration from events: counts against a pixel simulated event by event, lines, cells, memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.touch.vibration.edge_counts import (
    SPREAD,
    SPREAD_SHARE,
    Edge,
    _low_passed,
    edge_counts,
)
from spikingtac.touch.vibration.event_vibration import (
    EventVibrationConfig,
    EventVibrationMonitor,
    calibrated_edge,
)
from spikingtac.touch.vibration.line_search import Band, strongest_line
from spikingtac.touch.vibration.rim_amplitude import RimCounts, rim_amplitude
from spikingtac.touch.vibration.rim_cells import RINGS, SECTORS, RimCells, ring_distances_px
from spikingtac.touch.vibration.rim_memory import BIN_US, RimMemory
from spikingtac.types import EventPacket, MarkerFrame
from stand_ins.shaken_discs import CALIBRATION, CENTERS, EDGE, SIZE, shaken_stream


def pixel_events(distance_px: float, amplitude_px: float, hz: float, edge: Edge) -> list[float]:
    """Follow one pixel through 20 cycles in steps of 4 us; OFF and ON events of a cycle."""
    step_us = 4.0
    times = np.arange(0.0, 20.0 / hz * 1e6, step_us)
    away = (distance_px - amplitude_px * np.sin(2e-6 * np.pi * hz * times)) / edge.width_px
    light = (1.0 + (edge.contrast - 1.0) / (1.0 + np.exp(away))) / edge.contrast
    target = np.log(light)
    follows = 1.0 - np.exp(-step_us * light / edge.lag_us)
    rng = np.random.default_rng(1)
    found = np.zeros(2)
    for spread, share in zip(SPREAD, SPREAD_SHARE, strict=True):
        for start in rng.uniform(-0.5, 0.5, 4):
            on, off = spread * edge.threshold_on, spread * edge.threshold_off
            level, reference, dead_until = float(target[0]), 0.0, -1.0
            reference = level + start * on
            counted = np.zeros(2)
            for k, t_us in enumerate(times.tolist()):
                level += (target[k] - level) * follows[k]
                if t_us < dead_until:
                    reference = level
                    continue
                sign = 1 if level - reference >= on else 0 if reference - level >= off else -1
                if sign >= 0:
                    counted[sign] += t_us > 10.0 / hz * 1e6
                    reference, dead_until = level, t_us + edge.dead_us
            found += 0.25 * share * counted / 10.0
    return found.tolist()


@pytest.mark.parametrize(("distance_px", "hz"), [(0.0, 498.0), (0.8, 498.0), (-0.5, 240.0)])
def test_the_counts_are_those_of_a_simulated_pixel(distance_px: float, hz: float) -> None:
    told = edge_counts(np.array([distance_px]), np.array([0.8]), hz, EDGE)[:, 0, 0]
    assert told == pytest.approx(pixel_events(distance_px, 0.8, hz, EDGE), abs=0.45)


@pytest.mark.parametrize("lag_us", [0.0, 100.0, 2_000.0])
def test_the_low_pass_repeats_its_cycle(lag_us: float) -> None:
    level = np.log(1.0 + 4.0 / (1.0 + np.exp(3.0 * np.sin(np.linspace(0, 2 * np.pi, 49)[:-1]))))
    follows = 1.0 - np.exp(-np.exp(level) * 25.0 / max(lag_us, 1e-9))
    seen, now = np.empty(48), 0.0
    _low_passed(level, follows, seen)
    for _ in range(60):
        expected = [
            now := now + (own - now) * share for own, share in zip(level, follows, strict=True)
        ]
    np.testing.assert_allclose(seen, expected, atol=1e-12)


def test_what_does_not_reach_a_threshold_gives_no_event() -> None:
    assert edge_counts(ring_distances_px(), np.array([0.03]), 120.0, EDGE).max() == 0.0


@pytest.mark.parametrize("white", [True, False])
@pytest.mark.parametrize("amplitude_px", [0.5, 0.8, 1.2])
def test_an_amplitude_is_found_beside_lag_and_dead_time(amplitude_px: float, white: bool) -> None:
    camera = replace(EDGE, lag_us=220.0, dead_us=60.0)
    across = np.abs(np.cos((np.arange(SECTORS) + 0.5) * 2.0 * np.pi / SECTORS))
    distance = ring_distances_px() * (1.0 if white else -1.0)
    exact = edge_counts(distance, amplitude_px * across, 240.0, camera).transpose(0, 2, 1)
    rng = np.random.default_rng(3)
    counted = RimCounts(
        240.0,
        rng.poisson(exact * 300.0) / 300.0,
        np.full((RINGS, SECTORS), 40),
        across,
        white,
    )
    found = rim_amplitude(counted, EDGE)
    assert found.sigma_px is not None
    assert found.px == pytest.approx(amplitude_px, abs=max(0.05 * amplitude_px, 2 * found.sigma_px))
    assert 0.0 < found.sigma_px < 0.15 * amplitude_px


def test_too_few_events_tell_no_amplitude() -> None:
    few = np.full((2, RINGS, SECTORS), 0.02)
    counted = RimCounts(100.0, few, np.full((RINGS, SECTORS), 40), np.ones(SECTORS), True)
    assert rim_amplitude(counted, EDGE).px is None


BAND = Band(10.0, 1_000.0, 3.5, 32)


@pytest.mark.parametrize("hz", [20.3, 119.6, 498.0])
def test_a_line_lies_between_the_bins(hz: float) -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(4_000) / 4_000.0
    wave = 0.3 * np.sin(2.0 * np.pi * hz * time_s)[:, None] * [0.6, 0.8]
    found = strongest_line(wave + rng.normal(0.0, 1.0, (4_000, 2)), 4_000.0, BAND)
    assert found is not None
    assert found[0] == pytest.approx(hz, abs=0.3)


def test_noise_and_slow_motion_are_no_line() -> None:
    slow = 200.0 * np.exp(-(((np.arange(4_000) - 2_000.0) / 300.0) ** 2))[:, None]
    wrong = 0
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, (4_000, 2))
        wrong += strongest_line(noise, 4_000.0, BAND) is not None
        wrong += strongest_line(noise + slow, 4_000.0, BAND) is not None
    assert wrong <= 2  # 1 of 1,000 is expected


def test_cells_lie_around_the_edges() -> None:
    cells = RimCells(np.array([6.0, 6.0]), SIZE)
    cells.place(np.array([[30.0, 40.0], [70.0, 40.0]]))
    ring, sector = divmod(int(cells.cell[40, 37]), SECTORS)  # 1 px outside, to the right
    assert ring_distances_px()[ring] == pytest.approx(1.125)
    assert sector in (SECTORS // 2 - 1, SECTORS // 2)
    assert cells.cell[40, 30] == -1  # the middle is no rim
    assert cells.cell[40, 50] == -1
    area = 2 * np.pi * (9.0**2 - 3.0**2)
    assert cells.pixels.sum() == pytest.approx(area, rel=0.03)
    cells.place(np.array([[31.0, 40.0], [70.0, 40.0]]))
    assert divmod(int(cells.cell[40, 38]), SECTORS)[0] == ring


def test_a_pixel_between_two_markers_belongs_to_the_nearer_edge() -> None:
    cells = RimCells(np.array([6.0, 6.0]), SIZE)
    cells.place(np.array([[30.0, 40.0], [46.0, 40.0]]))
    assert divmod(int(cells.cell[40, 37]), SECTORS)[1] in (SECTORS // 2 - 1, SECTORS // 2)
    assert divmod(int(cells.cell[40, 39]), SECTORS)[1] in (0, SECTORS - 1)


SHORT = EventVibrationConfig(window_s=0.4, lowest_hz=20.0)


@pytest.fixture(scope="module")
def shaken() -> EventPacket:
    return shaken_stream(120.0, 0.8, 0.41)


def test_frequency_amplitude_and_direction_of_a_vibration(shaken: EventPacket) -> None:
    monitor = EventVibrationMonitor(CALIBRATION, SHORT)
    assert monitor.line() is None
    monitor.absorb(shaken)
    line = monitor.line()
    assert line is not None
    assert line.hz == pytest.approx(120.0, abs=0.3)
    assert line.amplitude_px == pytest.approx(0.8, rel=0.1)
    assert abs(line.direction[0]) == pytest.approx(1.0, abs=0.02)
    monitor.reset()
    assert monitor.line() is None


def test_the_packing_of_the_events_does_not_matter(shaken: EventPacket) -> None:
    whole, cut = (EventVibrationMonitor(CALIBRATION, SHORT) for _ in range(2))
    whole.absorb(shaken)
    for first_us in range(0, shaken.t_end_us, 1_700):
        last_us = min(first_us + 1_700, shaken.t_end_us)
        first, last = np.searchsorted(shaken.t, [first_us, last_us])
        cut.absorb(shaken.part(int(first), int(last), first_us, last_us))
    one, other = whole.line(), cut.line()
    assert one is not None
    assert other is not None
    assert (one.hz, one.amplitude_px) == (other.hz, other.amplitude_px)


def test_rest_has_no_line() -> None:
    monitor = EventVibrationMonitor(CALIBRATION, SHORT)
    monitor.absorb(shaken_stream(120.0, 0.0, 0.41))
    assert monitor.line() is None


def test_without_the_looks_of_the_edges_only_the_frequency_is_told(shaken: EventPacket) -> None:
    bare = replace(CALIBRATION, contrast=None)
    assert calibrated_edge(bare) is None
    monitor = EventVibrationMonitor(bare, SHORT)
    monitor.absorb(shaken)
    line = monitor.line()
    assert line is not None
    assert line.amplitude_px is line.sigma_px is None


@pytest.mark.parametrize("before_us", [(), (10**9,)], ids=["forward", "time goes back"])
def test_rims_follow_the_markers(shaken: EventPacket, before_us: tuple[int, ...]) -> None:
    moved = CENTERS + np.array([9.0, 4.0])
    shifted = replace(
        shaken, x=shaken.x + np.uint16(9), y=shaken.y + np.uint16(4), size=SIZE
    ).select((shaken.x < 80) & (shaken.y < 85))
    monitor = EventVibrationMonitor(CALIBRATION, SHORT)
    none, sure = np.zeros(4, np.bool_), np.ones(4)
    for t_us in (*before_us, 0, 60_000, 120_000):
        monitor.follow(MarkerFrame(t_us, moved, moved, moved - CENTERS, none, sure))
    monitor.absorb(shifted)
    line = monitor.line()
    assert line is not None
    assert line.amplitude_px == pytest.approx(0.8, rel=0.1)


def test_the_memory_keeps_the_last_bins_only() -> None:
    memory, cell = RimMemory(4), np.zeros((8, 8), np.int16)
    for k in range(6):
        at = np.array([k * BIN_US + 10], np.int64)
        one, on = np.array([3], np.uint16), np.array([k % 2 == 1])
        memory.absorb(EventPacket(one, one, on, at, k * BIN_US, (k + 1) * BIN_US, (8, 8)), cell)
    assert memory.full
    assert memory.t_us == 6 * BIN_US
    assert memory.counts()[:, 0, 0].tolist() == [[1, 0], [0, 1], [1, 0], [0, 1]]
    memory.absorb(EventPacket.empty(0, BIN_US, (8, 8)), cell)  # the stream began anew
    assert not memory.full
    assert memory.counts().sum() == 0.0
    with pytest.raises(ConfigError):
        memory.absorb(EventPacket.empty(0, BIN_US, (9, 8)), cell)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="lowest_hz"):
        EventVibrationConfig(lowest_hz=2_000.0)
    with pytest.raises(ValueError, match="4 cycles"):
        EventVibrationConfig(window_s=0.1)
    with pytest.raises(ValueError, match="there are 0 bins"):
        EventVibrationConfig(lowest_hz=10.2, highest_hz=10.6)
    with pytest.raises(ValueError, match="a window is finite"):
        EventVibrationConfig(window_s=np.inf)
    with pytest.raises(ValueError, match="neighbours"):
        EventVibrationConfig(neighbours=1)
