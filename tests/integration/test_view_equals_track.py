"""A recording that is viewed leaves the same tracks as one that is tracked."""

from pathlib import Path

import numpy as np
import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.events.open import open_events
from spikingtac.pipeline.track import track_to_file
from spikingtac.tracks import Tracks
from spikingtac.types import MarkerFrame
from spikingtac.viewer import session as module
from spikingtac.viewer.opening import open_view
from spikingtac.viewer.session import Session
from stand_ins.random_packets import save_events
from stand_ins.viewer import CirclingDots, open_circling

QUIET_US = 4_321  # The first event comes this long after the start of the stream, off every grid.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that begins with silence, and its calibration."""
    made = tmp_path_factory.mktemp("recording")
    source = CirclingDots(duration_us=400_000, noise_per_ms=5)
    save_events(made / "events.raw", *(part.select(part.t >= QUIET_US) for part in source))
    open_circling().calibration.save(made / "calibration.json")
    return made


@pytest.mark.parametrize("preset", ["default", "fast", "paper"])
def test_a_viewed_recording_gives_the_tracks_of_a_tracked_one(
    preset: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calibration = Calibration.load(folder / "calibration.json")
    config = load_config(preset).tracking
    track_to_file(open_events(folder), tmp_path / "tracked.npz", config, calibration)

    monkeypatch.setattr(module, "WORK_SHARE", 600.0)  # a step always reaches its aim
    session = Session(open_view(str(folder), preset=preset), bool, bool)
    frames: dict[int, MarkerFrame] = {}
    session.record.estimate = lambda frame: frames.setdefault(frame.t_us, frame)
    while session.playing:
        session.step()
        if session.playback.position_us == 250_000:  # going back adds nothing and changes nothing
            session.command("seek_us", 100_000)
    session.close()

    tracked, seen = Tracks.load(tmp_path / "tracked.npz"), list(frames.values())
    assert tracked.t_us.tolist() == list(frames)
    assert tracked.t_us[0] >= QUIET_US
    assert len(seen) > 100
    for name in ("detected_px", "position_px", "coasted"):
        found = np.array([getattr(frame, name) for frame in seen])
        np.testing.assert_array_equal(
            getattr(tracked, name), found.astype(getattr(tracked, name).dtype)
        )
    rates = [frame.health.rate_ev_s for frame in seen]
    assert rates[-1] > 0.0
    np.testing.assert_allclose(tracked.rate_ev_s, rates, rtol=1e-6)
    np.testing.assert_array_equal(tracked.gaps, [frame.health.gaps for frame in seen])
