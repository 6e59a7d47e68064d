"""Thresholds from quiet windows: hot pixels, tails that hold on other data, the leak's bias."""

import numpy as np
import pytest

from spikingtac.contact.evidence import AFFINE_MODES, OFF_RIM, ScaleSums, rim_table
from spikingtac.contact.quiet_evidence import (
    quiet_evidence,
    scale_test,
)
from spikingtac.errors import CalibrationError
from spikingtac.types import EventPacket
from stand_ins.moving_rims import GRID, calibration, windows

TABLE = rim_table(calibration())
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
    quiet = quiet_evidence([TABLE], map(with_hot_pixel, windows(3000, seed=1)))
    assert quiet.hot_pixels == (1,)
    assert TABLE.row[HOT[1], HOT[0]] != OFF_RIM
    assert quiet.tables[0].row[HOT[1], HOT[0]] == OFF_RIM
    assert quiet.period_s == pytest.approx(1e-3)


def test_a_stump_at_the_end_is_no_period() -> None:
    stump = EventPacket.empty(300_000, 300_001, TABLE.row.shape[::-1])
    whole = quiet_evidence([TABLE], windows(300, seed=1))
    cut = quiet_evidence([TABLE], [*windows(300, seed=1), stump])
    assert cut.period_s == whole.period_s
    assert np.isfinite(scale_test(cut, 1.0).threshold).all()


@pytest.mark.parametrize(("on", "name"), [(True, "OFF"), (False, "ON")])
def test_a_quiet_recording_of_one_polarity_is_refused(on: bool, name: str) -> None:
    one = (packet.select(packet.p == on) for packet in windows(300, seed=1))
    with pytest.raises(CalibrationError, match=f"no {name} event lies on the markers' rims"):
        quiet_evidence([TABLE], one)


def test_whitened_evidence_of_other_quiet_windows_has_unit_variance_at_most() -> None:
    test = scale_test(quiet_evidence([TABLE], windows(6000, seed=1)), 1.0)
    fresh = quiet_evidence([TABLE], windows(6000, seed=2)).evidence
    sums = ScaleSums(test)
    values = np.array([sums.add(evidence).copy() for evidence in fresh])[256:]
    # A chi-square of six; below it where the long scales leave room for the leak.
    assert values.mean(axis=0)[:6] == pytest.approx(AFFINE_MODES, rel=0.35)
    assert (values.mean(axis=0) < 1.4 * AFFINE_MODES).all()
