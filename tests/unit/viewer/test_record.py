"""What is kept of every estimate: a small, whole record, and what is felt."""

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.touch.elastic import SkinConfig, synthetic_series
from spikingtac.touch.force.fit import fit_force
from spikingtac.touch.force.model import ForceModel
from spikingtac.viewer import record as module
from spikingtac.viewer.export import steps, tracked
from spikingtac.viewer.source import FeltLayer
from stand_ins.live import frame_of
from stand_ins.viewer import open_circling


def test_a_record_stays_small_and_covers_the_whole_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_ROWS", 20)
    view = open_circling(1_000_000)
    record = module.Record()
    with tracked(view, None, record.estimate) as (playback, end_us):
        for _ in steps(playback, 16_000, end_us):
            record.take(playback)
            assert len(record._rows) <= 20
        playback.aim(500_000)  # going back and on counts as played
        playback.work(60.0)
        record.take(playback)
        next(steps(playback, 16_000, end_us))
        record.take(playback)
        summary = record.summary(playback)
        record.save_picture(tmp_path / "x.png", playback)
    times_s = np.array([row.t_s for row in record._rows])
    assert times_s[0] < 0.2
    assert times_s.max() > 0.9
    assert summary["played_s"] == pytest.approx(1.016, abs=0.002)
    assert summary["contacts"] == 1
    assert summary["error_mean_px"] < 0.1
    assert summary["displacement_max_px"] > 5.0
    assert (tmp_path / "x.png").read_bytes()[1:4] == b"PNG"


X, Y = np.meshgrid(np.arange(6.0), np.arange(6.0))
REFERENCE = 37.0 * np.column_stack([X.ravel(), Y.ravel()]) + 40.0


@pytest.fixture(scope="module")
def model() -> ForceModel:
    return fit_force(synthetic_series(SkinConfig(), REFERENCE, 15.4, frames=70))


def test_a_press_shows_force_patch_and_later_a_spectrum(model: ForceModel) -> None:
    layer = FeltLayer(REFERENCE, 200.0, model)
    assert layer.shown() == {}
    away = (REFERENCE - REFERENCE.mean(axis=0)) / 37.0
    press = 3.0 * away * np.exp(-0.5 * (away**2).sum(axis=1, keepdims=True))
    for k in range(150):
        share = np.clip((k - 50) / 40, 0.0, 1.0) ** 2
        layer.take(frame_of(k * 5_000 - 10_000_000, REFERENCE, share * press))
    shown = layer.shown()
    json.dumps(shown, allow_nan=False)
    assert shown["force_n"][2] > 0.05
    assert len(shown["outline_px"]) >= 3
    np.testing.assert_allclose(shown["place_px"], REFERENCE.mean(axis=0), atol=20.0)
    assert len(shown["spectrum_px"]) > 10
    layer.take(frame_of(-10_000_000, REFERENCE, 0.0 * press))
    assert layer.shown()["outline_px"] is None


def test_a_model_of_another_sensor_is_refused(model: ForceModel) -> None:
    with pytest.raises(ConfigError, match=r"the force model 36 in px"):
        FeltLayer(REFERENCE[:9], 200.0, model)
