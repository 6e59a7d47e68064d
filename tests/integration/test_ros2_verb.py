"""Frames reach an independent DDS participant in another process, as ROS 2 would read them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from spikingtac.ros2.messages import type_store
from spikingtac.ros2.stream import FIELD
from stand_ins import ros2_subscriber
from stand_ins.tracks import circling_tracks
from stand_ins.verbs import Verbs
from stand_ins.viewer import record_circling

pytest.importorskip("cyclonedds", reason="the extra [ros2] is not installed")
pytest.importorskip("rosbags", reason="rosbags is not installed")

FRAMES, LONG = 500, 15_000
FIELD_TYPE = "sensor_msgs/msg/PointCloud2"
PATIENCE_S = 60


@pytest.fixture
def domain() -> str:
    return str(1 + os.getpid() % 100)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Tracks, and longer ones that a publisher is not through with when it is ended."""
    paths = {count: tmp_path_factory.mktemp("tracks") / "tracks.npz" for count in (FRAMES, LONG)}
    for count, path in paths.items():
        circling_tracks(estimates=count, px_per_mm=8.0).save(path)
    return paths


class Crowd:
    """Processes that end with the test."""

    def __init__(self, domain: str, folder: Path) -> None:
        self.domain, self.folder = domain, folder
        self.processes: list[subprocess.Popen[str]] = []

    def subscriber(self, name: str, count: int, *options: str) -> subprocess.Popen[str]:
        given = [self.domain, "rt/tactile/field", FIELD_TYPE, str(self.folder / name)]
        script = ros2_subscriber.__file__
        process = self._start([script, *given, str(count), str(PATIENCE_S), *options])
        assert process.stdout.readline().strip() == "READY"
        return process

    def publisher(self, tracks: Path, *options: str) -> subprocess.Popen[str]:
        given = ["ros2", str(tracks), "--domain", self.domain, "--wait-s", str(PATIENCE_S)]
        return self._start(["-m", "spikingtac", *given, "--reliable", "--json", *options])

    def _start(self, arguments: list[str]) -> subprocess.Popen[str]:
        process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True)
        self.processes.append(process)
        return process

    def read(self, name: str) -> dict[str, np.ndarray]:
        with np.load(self.folder / name) as archive:
            return dict(archive)


@pytest.fixture
def crowd(domain: str, tmp_path: Path) -> Iterator[Crowd]:
    crowd = Crowd(domain, tmp_path)
    yield crowd
    for process in crowd.processes:
        process.kill()
        process.communicate()


def test_every_frame_arrives_as_it_was_tracked_and_a_slow_reader_does_no_harm(
    crowd: Crowd, saved: dict[int, Path]
) -> None:
    slow = crowd.subscriber("slow.npz", 1, "slow")
    reader = crowd.subscriber("all.npz", FRAMES, "reliable")
    said = json.loads(crowd.publisher(saved[FRAMES]).communicate(timeout=PATIENCE_S)[0])
    assert said["messages"]["field"] == FRAMES
    assert reader.wait(timeout=PATIENCE_S) == 0
    assert slow.poll() is None
    found, known = crowd.read("all.npz"), circling_tracks(estimates=FRAMES, px_per_mm=8.0)
    assert np.diff(found["t_ns"]).tolist() == (np.diff(known.t_us) * 1_000).tolist()
    cloud = np.array([np.frombuffer(row.tobytes(), FIELD) for row in found["data"]])
    for names, columns in (("uv", known.position_px), (("du", "dv"), known.displacement_px)):
        for axis, name in enumerate(names):
            np.testing.assert_array_equal(cloud[name], columns[..., axis])
    np.testing.assert_array_equal(cloud["valid"], ~known.coasted)
    assert found["names"][0].tolist() == list(FIELD.names or ())
    assert found["shape"][0].tolist() == [8, 8, FIELD.itemsize]
    told = {topic: (kind, data) for topic, kind, data in found["told"].tolist()}
    assert told["rt/tactile/field"] == (
        "sensor_msgs::msg::dds_::PointCloud2_",
        "typehash=RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5;",
    )
    assert set(told) >= {"rt/tactile/arrows", "rt/tactile/contact", "rt/diagnostics"}
    topics = [data for name, (_, data) in told.items() if name.startswith("rt/")]
    assert all(data.startswith("typehash=RIHS01_") for data in topics)


def test_a_late_reader_and_an_interrupt(crowd: Crowd, saved: dict[int, Path]) -> None:
    first = crowd.publisher(saved[LONG], "--wait-s", "0")
    late = crowd.subscriber("late.npz", 100, "reliable")
    assert late.wait(timeout=PATIENCE_S) == 0
    assert first.poll() is None, "it published before anybody read, and goes on"
    steps = np.diff(crowd.read("late.npz")["t_ns"])
    assert (steps == 1_000_000).all()  # late, but then without a gap
    first.send_signal(signal.SIGINT)
    said = json.loads(first.communicate(timeout=PATIENCE_S)[0])
    assert first.returncode == 0
    assert 0 < said["messages"]["field"] < LONG


def test_events_are_tracked_and_published(domain: str, tmp_path: Path, verbs: Verbs) -> None:
    given = ["--calibration", record_circling(tmp_path) / "calibration.json"]
    begun = time.monotonic()
    said = verbs.told("ros2", tmp_path, *given, "--domain", domain)
    assert time.monotonic() - begun > 0.59  # at the speed of the recording
    assert said["messages"]["field"] == pytest.approx(600, abs=2)
    assert said["messages"]["events"] == pytest.approx(60, abs=2)
    assert said["messages"]["diagnostics"] == 1
    assert "Ctrl-C ends" not in verbs.said("ros2", tmp_path, *given, "--rate-hz", "0", code=2)


@pytest.mark.parametrize(
    ("option", "value", "code", "told"),
    [
        ("--domain", "102", 2, "0 to 101"),
        ("--interface", "no0", 2, "no network interface"),
        ("--prefix", "/a b", 2, "no name of a topic"),
        ("--force", "no.json", 2, "no.json"),
        ("--calibration", "no.json", 1, "no.json"),
    ],
)
def test_mistakes_are_told(
    saved: dict[int, Path], option: str, value: str, code: int, told: str, verbs: Verbs
) -> None:
    assert told in verbs.said("ros2", saved[FRAMES], option, value, code=code)
    assert "Ctrl-C ends" not in verbs.err


@pytest.mark.parametrize(
    ("verb", "missing"), [("ros2", "cyclonedds"), ("foxglove", "rosbags.typesys")]
)
def test_the_extra_is_named_where_it_is_missing(
    verb: str, missing: str, saved: dict[int, Path], monkeypatch: pytest.MonkeyPatch, verbs: Verbs
) -> None:
    type_store.cache_clear()
    monkeypatch.setitem(sys.modules, missing, None)
    assert f"spikingtac[{verb}]" in verbs.said(verb, saved[FRAMES], code=3)
    assert "Ctrl-C ends" not in verbs.err
