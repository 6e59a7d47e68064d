"""The desk: a run in another process, its result, and a file that is saved or refused."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import PacketSource
from spikingtac.viewer.calibrating import WAYS, CalibrationDesk, SaveTarget
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


def test_the_guide_shows_the_grid(store: EventStore, tmp_path: Path) -> None:
    desk = desk_at(tmp_path / "calibration.json")
    scalars, arrays = desk.shown()
    assert (scalars["state"], scalars["grid"], arrays) == ("guide", None, {})
    for packet in sliding_packets():
        desk.tracker.absorb(packet)
    desk._made_s -= 1.0
    scalars, arrays = desk.shown()
    assert scalars["grid"] == list(GRID)
    assert scalars["ready"]
    assert arrays["guide_px"].shape == (GRID[0] * GRID[1], 2)
    assert {WAYS[code] for code in arrays["guide_way"]} == {""}
    assert scalars["path"] == str((tmp_path / "calibration.json").resolve())
    # Going back in time and playing again tells nothing new.
    before = desk.tracker.guide.view().share
    desk.tracker.absorb(sliding_packets()[0])
    np.testing.assert_array_equal(desk.tracker.guide.view().share, before)
    desk.begin_anew()
    assert desk.shown()[0]["grid"] is None
    desk.close()


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


def test_what_shows_no_grid_fails_with_the_reason(tmp_path: Path) -> None:
    rest = EventStore(PacketSource(sliding_packets()[:20], SIZE))
    rest.extend_to_end()
    desk = desk_at(tmp_path / "calibration.json")
    assert calibrated(desk, rest) is None
    scalars, _ = desk.shown()
    assert scalars["state"] == "failed"
    assert scalars["said"]
    assert not (tmp_path / "calibration.json").exists()
    desk.begin_anew()
    assert desk.shown()[0]["state"] == "guide"
