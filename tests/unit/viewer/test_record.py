"""The record of what was shown: small, whole, and drawn where there is something to draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from spikingtac.viewer import record as module
from spikingtac.viewer.export import steps, summarize, tracked
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


def test_a_recording_is_summarized_to_its_end() -> None:
    summary = summarize(open_circling(300_000))
    assert summary["played_s"] == pytest.approx(0.3, abs=0.011)
    assert summary["estimates"] == pytest.approx(300, abs=12)
