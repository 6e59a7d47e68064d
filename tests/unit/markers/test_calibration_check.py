"""A recording of another sensor contradicts the calibration; noise and its own do not."""

from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration_check import CalibrationCheck
from spikingtac.pipeline.follow import CheckedSource
from spikingtac.types import EventPacket
from stand_ins.known import known
from stand_ins.random_packets import packet_of
from stand_ins.rare_off import fired, levels

SIZE = (160, 128)
X, Y = np.meshgrid(np.arange(20.0, 150.0, 30.0), np.arange(20.0, 120.0, 30.0))
REST_PX = np.column_stack([X.ravel(), Y.ravel()])
RADIUS_PX, STEP, PERIOD_US = 6.0, 0.15, 1_000
PROFILE = DiscProfile(4.0, 0.6)


@pytest.fixture(scope="module")
def recording() -> EventPacket:
    """All discs go around in a circle."""
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    away_px = 4.0 * np.column_stack([np.sin(phase), 1.0 - np.cos(phase)])
    return recorded(PERIOD_US * np.arange(len(phase)), away_px)


def recorded(t_us: np.ndarray, displacement_px: np.ndarray) -> EventPacket:
    """Return the events of ideal pixels while all discs are displaced alike."""
    maps = (levels(REST_PX + away_px, PROFILE, SIZE, RADIUS_PX) for away_px in displacement_px)
    sample, pixel, p = fired(maps, STEP, STEP)
    return packet(pixel, p, t_us[sample])


def packet(pixel: np.ndarray, p: np.ndarray, t: np.ndarray) -> EventPacket:
    y, x = np.divmod(pixel, SIZE[0])
    return packet_of(t, x, y, p, SIZE, (0, int(t[-1]) + 1))


def calibration(moved_px: float = 0.0) -> Calibration:
    away = np.random.default_rng(1).normal(0.0, moved_px, REST_PX.shape)
    return known(REST_PX + away, RADIUS_PX, SIZE, (4, 5))


def judged(calibration: Calibration, *packets: EventPacket) -> CalibrationCheck:
    check = CalibrationCheck(calibration)
    for one in packets:
        check.absorb(one)
    check.finish()
    return check


def cut(whole: EventPacket, length: int) -> list[EventPacket]:
    parts = (whole.select(slice(k, k + length)) for k in range(0, len(whole), length))
    return [replace(one, t_start_us=int(one.t[0]), t_end_us=int(one.t[-1]) + 1) for one in parts]


def test_its_own_calibration_is_not_contradicted(recording: EventPacket) -> None:
    check = judged(calibration(), recording)
    assert check.contradiction < 0.02
    assert not check.foreign


@pytest.mark.parametrize("slowly_px", [0.0, 0.5, 1.0])
def test_a_slow_motion_and_its_fast_way_back_do_not_contradict_it(slowly_px: float) -> None:
    """The way back may begin slowly, too."""
    ways_px = np.interp(np.arange(430), [0, 300, 400, 430], [0.0, 3.0, 3.0 - slowly_px, 0.0])
    t_us = 100_000 * np.arange(430)
    t_us[400:] = 42_000_000 + 2_000 * np.arange(30)
    away_px = ways_px[:, None] * np.array([0.8, 0.6])
    assert not judged(calibration(), recorded(t_us, away_px)).foreign


def test_markers_that_stand_elsewhere_contradict_it(recording: EventPacket) -> None:
    check = judged(calibration(moved_px=1.5), recording)
    assert check.foreign
    assert check.contradiction > check.limit
    assert f"{check.contradiction:.0%} of the pixels" in check.words()


@pytest.mark.parametrize("length", [97, 1_000])
def test_any_cutting_gives_the_same_judgement(recording: EventPacket, length: int) -> None:
    for moved_px in (0.0, 1.5):
        whole = judged(calibration(moved_px), recording)
        parts = judged(calibration(moved_px), *cut(recording, length))
        assert parts.contradiction == whole.contradiction
        assert parts.ended == whole.ended


@pytest.mark.parametrize(("hz", "seconds"), [(1, 60), (5, 12)])
def test_noise_before_the_motion_is_forgotten(
    recording: EventPacket, hz: int, seconds: int
) -> None:
    rng, count = np.random.default_rng(2), SIZE[0] * SIZE[1] * seconds * hz
    noise = packet(
        rng.integers(0, SIZE[0] * SIZE[1], count),
        rng.random(count) < 0.5,
        np.sort(rng.integers(0, seconds * 1_000_000, count)),
    )
    later = replace(
        recording,
        t=recording.t + noise.t_end_us,
        t_start_us=noise.t_end_us,
        t_end_us=recording.t_end_us + noise.t_end_us,
    )
    assert not judged(calibration(), noise, later).foreign
    assert judged(calibration(1.5), noise, later).foreign


def test_a_checked_source_tells_once_and_passes_everything_on(recording: EventPacket) -> None:
    told: list[str] = []
    source = PacketSource(cut(recording, 5_000), SIZE)
    checked = CheckedSource(source, calibration(1.5), told.append)
    assert checked.size == SIZE
    assert sum(map(len, checked)) == len(recording)
    assert sum(map(len, checked)) == len(recording), "a file is read again"
    assert len(told) == 1
