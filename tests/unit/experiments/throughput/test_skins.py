"""The bench of big skins, on small ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.throughput import skins
from spikingtac_paper.throughput.skin_stream import (
    SKINS,
    Skin,
    calibration_at_rest,
    skin_stream,
)

SMALL = Skin((2, 3), (120, 90), 15.5, 0.45)
RATE_MEV_S = 0.3


def test_the_skins_of_the_table_fit_their_sensors_and_keep_their_discs_apart() -> None:
    assert [skin.count for skin in SKINS] == [64, 256, 1024]
    for skin in SKINS:
        pitch_px = 2.4 * skin.px_per_mm
        assert pitch_px > 2.0 * skin.radius_mm * skin.px_per_mm + 8.0
        assert pitch_px * skin.grid[1] <= skin.size[0]
        assert pitch_px * skin.grid[0] <= skin.size[1]


def test_a_stream_has_its_rate_its_markers_and_its_truth() -> None:
    stream = skin_stream(SMALL, RATE_MEV_S, 0, 60_000)
    assert stream.rate_hz == pytest.approx(RATE_MEV_S * 1e6, rel=0.25)
    assert stream.events.size == SMALL.size
    calibration = calibration_at_rest(SMALL, stream)
    assert len(calibration.reference_px) == SMALL.count
    spacing_px = np.diff(calibration.reference_px.reshape(2, 3, 2)[0, :, 0])
    assert spacing_px == pytest.approx(2.4 * SMALL.px_per_mm, abs=4.0)
    assert np.ptp(stream.truth.at(np.arange(0, 60_000, 1_000)), axis=0).max() > 1.0


def test_the_report_has_every_case_and_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skins, "SKINS", (SMALL,))
    monkeypatch.setattr(skins, "RATES_MEV_S", (0.3,))
    monkeypatch.setattr(skins, "QUICK_DURATION_US", 40_000)
    told = skins.run(RunOptions(output=tmp_path / "bench", quick=True))
    rows = json.loads((tmp_path / "bench" / "report.json").read_text())["rows"]
    assert {row["case"] for row in rows} == {"6@0.3", "6 slides"}
    steps = {(method, metric) for method in skins.METHODS for metric in skins.DEFINITIONS}
    slides = {(skins.CALIBRATION, metric) for metric in skins.CALIBRATION_DEFINITIONS}
    assert {(row["method"], row["metric"]) for row in rows} == steps | slides
    assert all(row["value"] > 0.0 for row in rows)
    errors = [row["value"] for row in rows if row["metric"] == "error_mean_px"]
    assert max(errors) < 0.5, "the markers are followed"
    rests = [row["value"] for row in rows if row["metric"] == "rest_error_px"]
    assert max(rests) < 0.1, "the calibration is right"
    assert told["findings"][0].startswith("default, 6 markers: ")
    assert told["findings"][-1].startswith("calibration of 6 markers from ")
