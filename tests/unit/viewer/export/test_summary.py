from pathlib import Path

import numpy as np
import pytest

from spikingtac.viewer.export import summary as module
from spikingtac.viewer.export.summary import Record
from spikingtac.viewer.session.wire import encode

REFERENCE_PX = np.zeros((64, 2))
FRAME_US = 16_000


def message(number: int, t_us: int, moved_px: float) -> tuple[int, bytes]:
    meta = {"t_us": t_us, "t_start_us": 0, "events_per_s": 1_000, "steps": number, "losses": {}}
    meta |= {"contacts_us": [], "contacts_found": number // 3, "displacement_max_px": moved_px}
    placed = np.full((64, 2), moved_px / np.sqrt(2), np.float32)
    arrays = {"position_px": placed, "detected_px": placed, "held": np.zeros(64, np.uint8)}
    return number, encode(meta, arrays | {"truth_px": 0.9 * placed})


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "MOST_ROWS", 50)
    return 50


def test_a_record_stays_small_and_covers_the_whole_session(short: int, tmp_path: Path) -> None:
    record = Record()
    for number in range(1, 1001):
        record.take(message(number, number * FRAME_US, 10.0 * number / 1000), REFERENCE_PX)
        assert len(record._rows) <= short
    times_s = np.array([row.t_s for row in record._rows])
    assert times_s[0] < 1.0
    assert times_s[-1] > 15.0
    assert len(np.unique(np.round(np.diff(times_s), 6))) == 1
    summary = record.summary()
    assert summary["played_s"] == pytest.approx(1000 * FRAME_US / 1e6)
    assert summary["displacement_max_px"] == pytest.approx(10.0, abs=1e-3)
    assert summary["error_mean_px"] == pytest.approx(0.5, abs=0.03)


def test_repeated_stretches_count_as_played() -> None:
    record = Record()
    for number, t_us in enumerate((0, 100_000, 200_000, 0, 100_000), start=1):
        record.take(message(number, t_us, 1.0), REFERENCE_PX)
    assert record.summary()["played_s"] == pytest.approx(0.3)
    assert record.summary()["contacts"] == 1


def test_nothing_seen_is_nothing_drawn(tmp_path: Path) -> None:
    record = Record()
    record.take(None, REFERENCE_PX)
    assert record.summary()["estimates"] == 0
    assert not record.save_picture(tmp_path / "x.png", {})
