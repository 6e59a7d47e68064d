"""A recording of another sensor contradicts the calibration; noise and its own do not."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from spikingtac.calibration.disc_profile import DiscProfile
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.markers.calibration_check import CalibrationCheck
from spikingtac.pipeline.follow import CheckedSource
from spikingtac.types import EventPacket

SIZE = (160, 128)
X, Y = np.meshgrid(np.arange(20.0, 150.0, 30.0), np.arange(20.0, 120.0, 30.0))
REST_PX = np.column_stack([X.ravel(), Y.ravel()])
RADIUS_PX, STEP, PERIOD_US = 6.0, 0.15, 1_000
PROFILE = DiscProfile(4.0, 0.6)


def levels(center_px: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    out = np.zeros((SIZE[1], SIZE[0]))
    for cx, cy in center_px:
        np.maximum(out, PROFILE.level(np.hypot(x - cx, y - cy) - RADIUS_PX), out=out)
    return out


def fired(t_us: np.ndarray, displacement_px: np.ndarray) -> Iterator[tuple[int, np.ndarray, bool]]:
    """Yield time, pixels and polarity of ideal pixels while all discs are displaced alike."""
    known = levels(REST_PX).ravel()
    for now_us, away_px in zip(t_us.tolist(), displacement_px, strict=True):
        now = levels(REST_PX + away_px).ravel()
        for rises in (True, False):
            sign = 1.0 if rises else -1.0
            while len(pixels := np.flatnonzero(sign * (now - known) > STEP)):
                known[pixels] += sign * STEP
                yield now_us, pixels, rises


@pytest.fixture(scope="module")
def recording() -> EventPacket:
    """All discs go around in a circle."""
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    away_px = 4.0 * np.column_stack([np.sin(phase), 1.0 - np.cos(phase)])
    return recorded(PERIOD_US * np.arange(len(phase)), away_px)


def recorded(t_us: np.ndarray, displacement_px: np.ndarray) -> EventPacket:
    parts = list(fired(t_us, displacement_px))
    pixel = np.concatenate([pixels for _, pixels, _ in parts])
    t = np.repeat([t for t, _, _ in parts], [len(pixels) for _, pixels, _ in parts])
    p = np.repeat([rises for *_, rises in parts], [len(pixels) for _, pixels, _ in parts])
    return packet(pixel, p, t)


def packet(pixel: np.ndarray, p: np.ndarray, t: np.ndarray) -> EventPacket:
    x, y = (pixel % SIZE[0]).astype(np.uint16), (pixel // SIZE[0]).astype(np.uint16)
    return EventPacket(x, y, p.astype(bool), t.astype(np.int64), 0, int(t[-1]) + 1, SIZE)


def calibration(moved_px: float = 0.0) -> Calibration:
    away = np.random.default_rng(1).normal(0.0, moved_px, REST_PX.shape)
    return Calibration(
        reference_px=REST_PX + away, radius_px=np.full(20, RADIUS_PX), grid=(4, 5), size=SIZE
    )


def judged(calibration: Calibration, *packets: EventPacket) -> CalibrationCheck:
    check = CalibrationCheck(calibration)
    for one in packets:
        check.absorb(one)
    check.finish()
    return check


def cut(whole: EventPacket, length: int) -> list[EventPacket]:
    starts = range(0, len(whole), length)
    parts = [(s, min(s + length, len(whole))) for s in starts]
    columns = (whole.x, whole.y, whole.p, whole.t)
    return [
        EventPacket(*(c[a:b] for c in columns), int(whole.t[a]), int(whole.t[b - 1]) + 1, SIZE)
        for a, b in parts
    ]


def test_its_own_calibration_is_not_contradicted(recording: EventPacket) -> None:
    check = judged(calibration(), recording)
    assert check.contradiction < 0.02
    assert not check.foreign


def test_a_slow_motion_and_its_fast_way_back_do_not_contradict_it() -> None:
    out, back = np.linspace(0.0, 3.0, 300), np.linspace(3.0, 0.0, 30)
    t_us = np.concatenate([100_000 * np.arange(300), 30_000_000 + 2_000 * np.arange(30)])
    away_px = np.concatenate([out, back])[:, None] * np.array([0.8, 0.6])
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
