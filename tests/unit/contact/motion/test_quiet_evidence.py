"""Thresholds from quiet windows: hot pixels, tails that hold on other data, the leak's bias."""

import numpy as np
import pytest

from spikingtac.contact.motion.quiet_evidence import LearningConfig, quiet_evidence, scale_test
from spikingtac.contact.motion.rim_evidence import AFFINE_MODES, OFF_RIM, RimConfig, rim_table
from spikingtac.contact.motion.scales import ScaleSums
from spikingtac.contact.motion.tail import tail_threshold
from spikingtac.errors import CalibrationError
from spikingtac.types import EventPacket
from stand_ins.moving_rims import GRID, calibration, windows

CONFIG = LearningConfig()
TABLE = rim_table(calibration(), RimConfig())
HOT = (round(GRID[4][0]) + 7, round(GRID[4][1]))


def with_hot_pixel(packet: EventPacket) -> EventPacket:
    if packet.t_start_us % 20_000:
        return packet
    extra = EventPacket(
        np.array([HOT[0]], np.uint16), np.array([HOT[1]], np.uint16), np.array([True]),
        np.array([packet.t_start_us]), packet.t_start_us, packet.t_end_us, packet.size,
    )  # fmt: skip
    return EventPacket.concatenate([extra, packet])


def test_hot_pixels_on_the_rims_lose_their_say() -> None:
    quiet = quiet_evidence([TABLE], map(with_hot_pixel, windows(3000, seed=1)), CONFIG)
    assert quiet.hot_pixels == (1,)
    assert TABLE.row[HOT[1], HOT[0]] != OFF_RIM
    assert quiet.tables[0].row[HOT[1], HOT[0]] == OFF_RIM
    assert quiet.period_s == pytest.approx(1e-3)


def test_a_stump_at_the_end_is_no_period() -> None:
    stump = EventPacket.empty(300_000, 300_001, TABLE.row.shape[::-1])
    whole = quiet_evidence([TABLE], windows(300, seed=1), CONFIG)
    cut = quiet_evidence([TABLE], [*windows(300, seed=1), stump], CONFIG)
    assert cut.period_s == whole.period_s
    assert np.isfinite(scale_test(cut, CONFIG, 1.0).threshold).all()


@pytest.mark.parametrize(("on", "name"), [(True, "OFF"), (False, "ON")])
def test_a_quiet_recording_of_one_polarity_is_refused(on: bool, name: str) -> None:
    one = (packet.select(packet.p == on) for packet in windows(300, seed=1))
    with pytest.raises(CalibrationError, match=f"no {name} event lies on the markers' rims"):
        quiet_evidence([TABLE], one, CONFIG)


def test_a_short_recording_allows_for_fewer_scales() -> None:
    quiet = quiet_evidence([TABLE], windows(300, seed=1), CONFIG)
    assert scale_test(quiet, CONFIG, 1.0).windows.tolist() == [1, 2, 4, 8, 16, 32]


def test_whitened_evidence_of_other_quiet_windows_has_unit_variance_at_most() -> None:
    test = scale_test(quiet_evidence([TABLE], windows(6000, seed=1), CONFIG), CONFIG, 1.0)
    fresh = quiet_evidence([TABLE], windows(6000, seed=2), CONFIG).evidence
    sums = ScaleSums(test)
    values = np.array([sums.add(evidence).copy() for evidence in fresh])[256:]
    # A chi-square of six; below it where the long scales leave room for the leak.
    assert values.mean(axis=0)[:6] == pytest.approx(AFFINE_MODES, rel=0.35)
    assert (values.mean(axis=0) < 1.4 * AFFINE_MODES).all()


def test_the_leak_weighs_on_the_on_evidence_of_the_long_scales_only() -> None:
    test = scale_test(quiet_evidence([TABLE], windows(6000, seed=1), CONFIG), CONFIG, 1.0)
    weight = (test.whiten**2).sum(axis=1).reshape(len(test.windows), 2, AFFINE_MODES).sum(axis=2)
    share = weight[:, 1] / weight[:, 0]
    assert share[0] > 0.3
    assert share[-1] < 0.1
    assert (share[1:] < share[:-1]).all()


def vibration(seed: int, windows: int, rms: float = 1.0) -> np.ndarray:
    """Return |x| of a resonance at 15 Hz with Q 5, sampled at 1 kHz."""
    rng = np.random.default_rng(seed)
    omega, quality, dt = 2.0 * np.pi * 15.0, 5.0, 1e-3
    radius = np.exp(-omega * dt / (2.0 * quality))
    drive = rng.normal(size=windows)
    out = np.zeros(windows)
    for k in range(2, windows):
        out[k] = 2.0 * radius * np.cos(omega * dt) * out[k - 1] - radius**2 * out[k - 2] + drive[k]
    return rms * np.abs(out) / out.std()


@pytest.mark.parametrize("seed", range(3))
def test_the_tail_of_a_bursty_amplitude_holds_on_disjoint_data(seed: int) -> None:
    learned, block = vibration(seed, 60_000), 100
    other = vibration(seed + 100, 300_000)
    peaks = other.reshape(-1, block).max(axis=1)
    for chance in (1e-2, 1e-3):  # 30 and 3 blocks of the five minutes
        threshold = tail_threshold(learned, block, chance)
        assert (peaks > threshold).mean() <= 2.0 * chance
        assert threshold < 8.0  # of a standard deviation: not at the price of everything


def test_the_tail_of_an_exponential_amplitude_is_met() -> None:
    rng = np.random.default_rng(1)
    found = [tail_threshold(rng.exponential(size=20_000), 1, 1e-6) for _ in range(50)]
    assert np.mean(found) == pytest.approx(np.log(1e6), rel=0.2)
    assert np.mean([value > np.log(1e6) * 0.9 for value in found]) > 0.9


def test_a_tail_needs_two_blocks() -> None:
    assert tail_threshold(np.ones(150), 100, 1e-3) == float("inf")
