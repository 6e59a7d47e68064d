"""The desk: a run in another process, its result, and a file that is saved or refused."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.viewer.calibrating import CalibrationDesk, SaveTarget
from spikingtac.viewer.replay.event_store import EventStore
from stand_ins.sliding import GRID, SIZE, sliding_packets

PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def store() -> EventStore:
    store = EventStore(PacketSource(sliding_packets(), SIZE))
    store.extend_to_end()
    return store


def desk_at(path: Path, *, overwrite: bool = False) -> CalibrationDesk:
    return CalibrationDesk("slides.raw", SIZE, SaveTarget(path=path, overwrite=overwrite), None)


def calibrated(desk: CalibrationDesk, store: EventStore) -> Calibration | None:
    desk.calibrate(store, store.t_end_us)
    until_s = time.monotonic() + PATIENCE_S
    while (found := desk.poll()) is None and time.monotonic() < until_s:
        if desk.shown()[0]["state"] == "failed":
            return None
        time.sleep(0.02)
    return found


def test_a_calibration_is_computed_saved_and_told(store: EventStore, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    desk = desk_at(path)
    found = calibrated(desk, store)
    assert found is not None
    assert found.grid == GRID
    scalars, _ = desk.shown()
    assert scalars["state"] == "done"
    assert scalars["said"] == f"Saved as {path.resolve()}"
    assert scalars["result"]["measured"] == GRID[0] * GRID[1]
    saved = Calibration.load(path)
    np.testing.assert_allclose(saved.reference_px, found.reference_px, atol=1e-3)
    assert saved.provenance["recording"] == "slides.raw"
    before = path.read_bytes()
    refused = desk_at(path)._saved(found)
    assert "was not saved" in refused
    assert "--overwrite" in refused
    assert path.read_bytes() == before
    assert desk_at(path, overwrite=True)._saved(found) == scalars["said"]
