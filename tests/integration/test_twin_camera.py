"""The twin as a camera: its scene's events as time passes, with the truth beside them."""

import time
from pathlib import Path

import numpy as np

from spikingtac.events.camera import Address
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.formats.file_source import ReadOptions
from spikingtac.events.open import open_events
from spikingtac.events.recording import Recording
from spikingtac.sim import catalog
from spikingtac.sim.source import SceneSource
from spikingtac.stream.record import prepare_folder, record
from spikingtac.types import EventPacket
from spikingtac.viewer.opening import open_view


def test_it_gives_the_events_of_its_scene_as_time_passes() -> None:
    source = CameraSource(Address.parse("twin:quiet?seed=3&seconds=0.4"), ReadOptions())
    begun_s, early = time.monotonic(), []
    packets: list[EventPacket] = []
    for packet in source:
        early.append(packet.t_end_us / 1e6 - (time.monotonic() - begun_s))
        packets.append(packet)
    source.release()
    found = EventPacket.concatenate(packets)
    wanted = EventPacket.concatenate(
        list(SceneSource(catalog.load_scene("quiet"), 3, duration_s=1.0))
    )
    assert len(found) > 100
    np.testing.assert_array_equal(found.t, wanted.t[: len(found)])
    np.testing.assert_array_equal(found.x, wanted.x[: len(found)])
    assert max(early) < 0.02  # at most what had come before the first look


def test_its_recording_reads_like_a_simulation(tmp_path: Path) -> None:
    source = CameraSource(Address.parse("twin:quiet?seed=3"), ReadOptions())
    prepare_folder(tmp_path / "rec", overwrite=False)
    told = record([source], tmp_path / "rec", seconds=1.5)
    assert told["ended"] == "seconds"
    pace = told["camera"]["pace"]
    assert pace["packets"] > 100
    assert 0 <= pace["late_packets"] <= pace["packets"]
    recording = Recording.open(tmp_path / "rec")
    truth = recording.truth()
    assert truth["marker_px"].shape[1:] == (64, 2)
    assert truth["marker_t_us"][-1] >= recording.manifest["t_end_us"] - 10_000
    assert recording.manifest["source"] == "twin"
    assert sum(len(packet) for packet in open_events(tmp_path / "rec")) == told["events"]
    view = open_view(str(tmp_path / "rec"))
    assert view.simulated
    assert view.calibration.grid == (8, 8)
