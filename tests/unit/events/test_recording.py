"""Recording folders: written in pieces, the same bytes, opened again."""

import json
from pathlib import Path

import numpy as np
import pytest

from spikingtac.cli.main import main
from spikingtac.errors import RecordingError
from spikingtac.events import Recording, RecordingWriter, open_events
from spikingtac.events.create import create_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import packet_at
from stand_ins.tracks import circling_tracks

SIZE = (32, 24)


def packet(first_us: int) -> EventPacket:
    return packet_at(range(first_us, first_us + 10), (first_us, first_us + 10), SIZE)


def record(folder: Path, sensors: int = 1) -> None:
    with RecordingWriter(folder, SIZE, sensors) as writer:
        for step in range(4):
            for sensor in range(sensors):
                writer.write(packet(100 * step + sensor), sensor)
            marker_px = np.full((1, 2, 2), step, np.float32)
            writer.truth_file().append(
                {"marker_t_us": np.array([100 * step]), "marker_px": marker_px}
            )
        writer.truth_file().set("reference_px", np.zeros((2, 2)))
        writer.losses.add("readout", 3)
        writer.describe(seed=7, scene={"name": "test"})


def test_a_folder_is_read_as_it_was_written(tmp_path: Path) -> None:
    record(tmp_path / "a", sensors=2)
    recording = Recording.open(tmp_path / "a")
    truth = recording.truth()
    assert truth["marker_t_us"].tolist() == [0, 100, 200, 300]
    assert truth["marker_px"].shape == (4, 2, 2)
    assert truth["marker_px"].dtype == np.float32
    assert truth["reference_px"].shape == (2, 2)
    assert next(part.t[0] for part in recording.events(1)) == 1
    assert sum(len(part) for part in open_events(tmp_path / "a", sensor=1)) == 40
    manifest = recording.manifest
    assert (manifest["sensors"], manifest["t_start_us"], manifest["t_end_us"]) == (2, 0, 311)
    assert (manifest["seed"], manifest["losses"]) == (7, {"readout": 3})
    assert manifest["size"] == [32, 24]


def test_a_failed_recording_has_no_manifest(tmp_path: Path) -> None:
    record(tmp_path / "a")
    with pytest.raises(IndexError), RecordingWriter(tmp_path / "a", SIZE) as writer:
        [writer.write(packet(0), sensor) for sensor in (0, 5)]
    assert not (tmp_path / "a" / "manifest.json").exists()
    recording = Recording.open(tmp_path / "a")
    assert (recording.manifest, recording.truth()) == ({}, None)
    assert sum(len(part) for part in recording.events()) == 10


def test_what_cannot_be_opened_is_explained(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no events\.raw"):
        Recording.open(tmp_path)
    record(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps({"schema": 99}))
    with pytest.raises(RecordingError, match="schema 99"):
        Recording.open(tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.open(tmp_path)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "truth.npz").write_bytes(b"no archive")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.open(tmp_path).truth()


def test_a_truth_that_does_not_fit_is_at_fault(tmp_path: Path) -> None:
    tracks = circling_tracks(estimates=10)
    tracks.save(tmp_path / "tracks.npz")
    create_events(tmp_path / "events.raw", (320, 320)).close()
    made, known = tmp_path / "tracks.npz", tmp_path / "truth.npz"
    t_us, place_px = tracks.t_us, tracks.position_px
    sound = {"marker_t_us": t_us, "marker_px": place_px, "contact_t_us": t_us}
    for change in (
        {"marker_px": place_px[..., :1]}, {"marker_px": place_px * np.nan},
        {"marker_px": place_px[0]}, {"marker_t_us": t_us.astype(str)},
        {"marker_t_us": t_us[::-1]}, {"marker_t_us": t_us + (1 << 60)}, {"force_n": t_us},
    ):  # fmt: skip
        np.savez(known, **sound | change)
        for words in (
            f"info {known}", f"compare {made} {known}", f"force fit {made} --wrench {known}",
            f"view {tmp_path} --headless --port 0",
        ):  # fmt: skip
            assert main(words.split()) == 1
