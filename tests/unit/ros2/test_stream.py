"""What is published of a sensor, and its bytes as rosbags reads them."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import Stores, get_typestore

from spikingtac.events import open_events
from spikingtac.ros2.feed import rehearse
from spikingtac.ros2.messages import definition, encode, type_store
from spikingtac.ros2.stream import FIELD, SensorInfo, SensorStream
from spikingtac.stream.paced import Pace
from spikingtac.types import EventPacket
from stand_ins.live import frame_of
from stand_ins.tracks import HELD_MARKER, circling_tracks

NOW_NS = 1_700_000_000_000_000_000

# Hash of PointCloud2 as it stands in rcl's own tests, test_type_hash.cpp.
POINT_CLOUD_HASH = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"


class Kept:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.topics: dict[str, tuple[str, bool]] = {}
        self.sent: list[tuple[str, Mapping[str, Any]]] = []

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        self.topics[topic] = (message, state)

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        assert topic in self.topics
        self.sent.append((topic, values))

    def readers(self, topic: str) -> int:
        return 3

    def of(self, topic: str) -> list[Mapping[str, Any]]:
        return [values for name, values in self.sent if name == topic]


TRACKS = circling_tracks(estimates=2_500, px_per_mm=8.0)
SENSOR = SensorInfo(TRACKS.reference_px, (8, 8), 8.0, (320, 320), "left", has_events=True)
EVENTLESS = replace(SENSOR, has_events=False)


@pytest.fixture
def kept() -> Kept:
    return Kept()


def stream(kept: Kept, sensor: SensorInfo = SENSOR, **settings: Any) -> SensorStream:
    return SensorStream(kept, sensor, clock_ns=lambda: NOW_NS, **settings)


def test_topics_and_their_types(kept: Kept) -> None:
    stream(kept, replace(SENSOR, has_wrench=True)).frame(next(TRACKS.frames()), np.arange(1.0, 7.0))
    (message,) = kept.of("/tactile/wrench")
    assert message["wrench"]["force"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert message["wrench"]["torque"] == {"x": 4.0, "y": 5.0, "z": 6.0}
    assert kept.topics == {
        "/tactile/field": ("sensor_msgs/PointCloud2", False),
        "/tactile/arrows": ("visualization_msgs/MarkerArray", False),
        "/tactile/contact": ("std_msgs/Bool", True),
        "/tactile/wrench": ("geometry_msgs/WrenchStamped", False),
        "/tactile/events": ("event_camera_msgs/EventPacket", False),
        "/tactile/camera_info": ("sensor_msgs/CameraInfo", True),
        "/diagnostics": ("diagnostic_msgs/DiagnosticArray", False),
    }
    other = Kept()
    stream(other, EVENTLESS, prefix="/hand/left")
    assert set(other.topics) == {
        "/hand/left/field", "/hand/left/arrows", "/hand/left/contact", "/diagnostics",
        "/hand/left/camera_info",
    }  # fmt: skip


def test_every_frame_is_a_field_and_the_rest_is_sent_when_due(kept: Kept) -> None:
    publishing, thinned = stream(kept, EVENTLESS), Kept()
    display = stream(thinned, EVENTLESS, field_hz=100.0)
    for frame in TRACKS.frames():
        publishing.frame(frame, figures={"overflow": 2})
        display.frame(frame)
    assert len(kept.of("/tactile/field")) == 2_500
    assert len(thinned.of("/tactile/field")) == 250
    stamps = [m["header"]["stamp"] for m in kept.of("/tactile/field")]
    t_ns = [stamp["sec"] * 10**9 + stamp["nanosec"] for stamp in stamps]
    assert t_ns[0] == NOW_NS  # this host's time, and the distances are the sensor's
    assert np.diff(t_ns).tolist() == (np.diff(TRACKS.t_us) * 1_000).tolist()
    assert len(kept.of("/tactile/arrows")) == 75  # 30 Hz in 2.5 s
    told = kept.of("/diagnostics")
    assert len(told) == 3
    (status,) = told[-1]["status"]
    assert status["message"] == "1 markers held"
    values = {pair["key"]: pair["value"] for pair in status["values"]}
    assert (values["readers"], values["overflow"], values["frames"]) == ("3", "2", "2001")
    assert status["hardware_id"] == "left"
    known = kept.of("/tactile/camera_info")
    assert len(known) == 4  # before the first frame, too
    assert set(known[0]) == {"header", "width", "height"}  # the rest is zero: not calibrated


def test_the_field_holds_what_was_tracked(kept: Kept) -> None:
    frame = next(TRACKS.frames())
    stream(kept).frame(frame)
    (message,) = kept.of("/tactile/field")
    cloud = np.frombuffer(message["data"], FIELD)
    np.testing.assert_array_equal(cloud["u"], frame.position_px[:, 0].astype(np.float32))
    np.testing.assert_array_equal(cloud["dv"], frame.displacement_px[:, 1].astype(np.float32))
    np.testing.assert_allclose(cloud["x"], (TRACKS.reference_px[:, 0] - 159.5) / 8.0, rtol=1e-6)
    assert not cloud["z"].any()
    assert np.flatnonzero(cloud["valid"] == 0).tolist() == [HELD_MARKER]
    assert message["row_step"] * message["height"] == len(message["data"])
    (lines,) = kept.of("/tactile/arrows")[0]["markers"]  # metres, of what was seen
    ends = np.array([[point["x"], point["y"]] for point in lines["points"]]).reshape(-1, 2, 2)
    moved_m = frame.displacement_px[~frame.coasted] / 8.0 / 1e3
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], moved_m, atol=1e-9)


def test_contact_is_told_at_its_changes(kept: Kept) -> None:
    publishing = stream(kept, EVENTLESS)
    rest = TRACKS.reference_px.astype(float)
    away = rest - rest.mean(axis=0)
    for step in range(300):
        publishing.frame(frame_of(step * 1_000, rest, 0.08 * away * (100 <= step < 200)))
    assert [message["data"] for message in kept.of("/tactile/contact")] == [False, True, False]


def test_events_survive_their_messages(kept: Kept, tmp_path: Path) -> None:
    publishing = stream(kept)
    rng = np.random.default_rng(1)
    packets = []
    for start_us in range(50_000, 90_000, 10_000):
        t = np.sort(rng.integers(start_us, start_us + 10_000, 200))
        x, y = (rng.integers(0, 320, 200).astype(np.uint16) for _ in "xy")
        size, p = (320, 320), rng.random(200) < 0.5
        packets.append(EventPacket(x, y, p, t, start_us, start_us + 10_000, size))
        publishing.events(packets[-1])
    messages = kept.of("/tactile/events")
    assert [message["seq"] for message in messages] == [0, 1, 2, 3]
    words = b"".join(message["events"] for message in messages)
    (tmp_path / "a.raw").write_bytes(b"% evt 3.0\n% geometry 320x320\n% end\n" + words)
    found = EventPacket.concatenate(list(open_events(tmp_path / "a.raw")))
    whole = EventPacket.concatenate(packets)
    origin_us = messages[0]["time_base"] // 1_000
    np.testing.assert_array_equal(found.t + origin_us, whole.t)
    for name in ("x", "y", "p"):
        columns = getattr(found, name), getattr(whole, name)
        np.testing.assert_array_equal(*(np.sort(column) for column in columns))


def test_every_branch_is_taken_in_a_rehearsal(monkeypatch: pytest.MonkeyPatch) -> None:
    told, real = [], SensorStream.frame
    monkeypatch.setattr(SensorStream, "frame", lambda *given: (real(*given), told.append(given[0])))
    rehearse(SENSOR)
    assert told[-1].counts["contact"] == 3  # rest, touch, rest


def test_recordings_are_played_at_their_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns, slept_s = [100_000_000_000], []
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: slept_s.append(round(seconds, 6)))
    pace = Pace()
    for t_us in (5_000, 6_000, 8_000):
        pace.wait(t_us)
        now_ns[0] += round(1e9 * slept_s[-1])
    assert slept_s == [0.0, 0.001, 0.002]
    now_ns[0] += 500_000_000
    pace.wait(9_000)
    assert pace.behind_ms() == pace.most_ms == pytest.approx(499)
    assert slept_s[-1] == 0.0


def test_the_hash_is_the_one_in_rcl() -> None:
    assert type_store().hash_rihs01("sensor_msgs/msg/PointCloud2") == POINT_CLOUD_HASH
    text = definition("event_camera_msgs/EventPacket")
    assert text.startswith("std_msgs/Header header")
    assert "MSG: builtin_interfaces/Time" in text


@pytest.mark.parametrize("release", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_given_fields_are_read_back_and_the_rest_is_zero_or_empty(release: Stores) -> None:
    given = {"ns": "é", "points": [{"x": 1.5}, {"y": -2.0}], "pose": {"orientation": {"w": 1.0}}}
    store = get_typestore(release)
    found = store.deserialize_cdr(
        encode("visualization_msgs/Marker", given), "visualization_msgs/msg/Marker"
    )
    assert [(p.x, p.y, p.z) for p in found.points] == [(1.5, 0.0, 0.0), (0.0, -2.0, 0.0)]
    assert (found.ns, found.id, found.pose.orientation.w, found.text) == ("é", 0, 1.0, "")
    k = [float(n) for n in range(9)]
    info = store.deserialize_cdr(
        encode("sensor_msgs/CameraInfo", {"k": k, "d": [0.5]}), "sensor_msgs/msg/CameraInfo"
    )
    assert (info.k.tolist(), info.d.tolist(), info.p.tolist()) == (k, [0.5], [0.0] * 12)


def test_unknown_fields_and_arrays_of_another_length_are_refused() -> None:
    with pytest.raises(KeyError, match="no field 'colour'"):
        encode("visualization_msgs/Marker", {"colour": 1})
    with pytest.raises(ValueError, match="2 values, an array of 9"):
        encode("sensor_msgs/CameraInfo", {"k": [1.0, 2.0]})
