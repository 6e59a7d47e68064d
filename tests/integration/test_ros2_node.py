"""A published sensor as a node: seen by ``ros2 node``, changed by ``ros2 param``, with camera info.

Asked by a participant whose types come from ROS 2's published definitions.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="the extra [ros2] is not installed")
pytest.importorskip("rosbags", reason="rosbags is not installed")

from cyclonedds.core import Policy

from stand_ins.ros2_client import Client, joined, wait_for
from stand_ins.tracks import circling_tracks
from stand_ins.viewer import open_circling, record_circling

INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
DOUBLE, STRING = 3, 4
SERVICES = {
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters",
    "set_parameters", "set_parameters_atomically", "reset",
}  # fmt: skip


FRAME_US = 10_000


def domain(other: int = 0) -> int:
    return 1 + (os.getpid() + other) % 100


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A node that waits for a reader of its tracks, and a client."""
    folder = tmp_path_factory.mktemp("published")
    tracks = circling_tracks(estimates=1_000, px_per_mm=8.0)
    slow = replace(tracks, t_us=tracks.t_us * FRAME_US // 1_000)
    slow.save(folder / "tracks.npz")
    given = [str(folder / "tracks.npz"), "--domain", str(domain()), "--prefix", "/hand/left"]
    given += ["--wait-s", "120"]
    process = subprocess.Popen([sys.executable, "-m", "spikingtac", "ros2", *given])
    with joined(domain()) as client:
        yield client
    process.kill()
    process.communicate()


def value(client: Client, kind: int, field: str, given: Any) -> Any:
    """Return a ParameterValue of one type."""
    empty = {"bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": ""}
    lists = ("byte", "bool", "integer", "double", "string")
    empty |= {f"{name}_array_value": [] for name in lists}
    return client.struct("rcl_interfaces/msg/ParameterValue")(type=kind, **empty | {field: given})


def parameter(client: Client, name: str, given: float | str) -> Any:
    kind = STRING if isinstance(given, str) else DOUBLE
    field = "string_value" if isinstance(given, str) else "double_value"
    held = value(client, kind, field, given)
    return client.struct("rcl_interfaces/msg/Parameter")(name=name, value=held)


def ask(client: Client, service: str, **values: Any) -> Any:
    kind = "".join(part.capitalize() for part in service.split("_"))
    return client.ask(f"/hand/left/{service}", f"rcl_interfaces/{kind}", **values)


def told(client: Client) -> Any:
    """Return what the participant says of its nodes."""
    reader = client.reader("ros_discovery_info", INFO, latched=True)
    return wait_for(lambda: [one for one in reader.take(8) if hasattr(one, "gid")], "no node")[0]


def test_the_node_and_its_endpoints_are_announced(published: Client) -> None:
    (node,) = told(published).node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/hand", "left")
    readers = {bytes(gid.data) for gid in node.reader_gid_seq}
    writers = {bytes(gid.data) for gid in node.writer_gid_seq}
    found = {one.key.bytes: one for one in published.endpoints(writers=False)}
    asked = {found[gid].topic_name: found[gid] for gid in readers}
    assert set(asked) == {f"rq/hand/left/{name}Request" for name in SERVICES}
    sent = {one.key.bytes: one for one in published.endpoints(writers=True)}
    topics = {sent[gid].topic_name for gid in writers}
    assert topics > {f"rr/hand/left/{name}Reply" for name in SERVICES}
    assert topics > {"rt/hand/left/field", "rt/parameter_events", "rt/diagnostics"}
    one = asked["rq/hand/left/set_parametersRequest"]
    assert one.type_name == "rcl_interfaces::srv::dds_::SetParameters_Request_"
    data = bytes(one.qos[Policy.Userdata].data).decode()
    assert data.startswith("serviceid=")
    assert ";typehash=RIHS01_" in data


def test_parameters_are_listed_got_and_described(published: Client) -> None:
    every = ask(published, "list_parameters", prefixes=[], depth=0).result
    assert {"source", "publish.field_hz", "contact.noise_factor"} <= set(every.names)
    assert every.prefixes == ["contact", "publish"]
    some = ask(published, "list_parameters", prefixes=["publish"], depth=0).result
    assert some.names == ["publish.field_hz", "publish.arrows_hz"]
    top = ask(published, "list_parameters", prefixes=[], depth=1).result
    assert top.names == ["source"]
    names = ["source", "contact.noise_factor", "nothing"]
    first, second, none = ask(published, "get_parameters", names=names).values
    assert (first.type, first.string_value) == (STRING, "tracks.npz")
    assert (second.type, second.double_value) == (DOUBLE, 6.0)
    assert none.type == 0
    assert list(ask(published, "get_parameter_types", names=names).types) == [STRING, DOUBLE]
    fixed, open_ = ask(published, "describe_parameters", names=names).descriptors
    assert fixed.read_only
    assert not open_.read_only
    assert open_.floating_point_range[0].from_value == 1.0
    assert open_.floating_point_range[0].to_value == 50.0
    assert "touch" in open_.description


def test_all_or_none_are_set_atomically(published: Client) -> None:
    good = parameter(published, "contact.noise_factor", 9.0)
    bad = parameter(published, "contact.end_share", 7.0)
    refused = ask(published, "set_parameters_atomically", parameters=[good, bad]).result
    assert not refused.successful
    (before,) = ask(published, "get_parameters", names=["contact.noise_factor"]).values
    assert before.double_value == 6.0
    assert ask(published, "set_parameters_atomically", parameters=[good]).result.successful
    (after,) = ask(published, "get_parameters", names=["contact.noise_factor"]).values
    assert after.double_value == 9.0


def test_a_parameter_is_set_and_takes_effect(published: Client) -> None:
    events = published.reader("rt/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    wait_for(events.get_matched_publications, "nobody tells of changes")
    given = [
        parameter(published, "publish.field_hz", 20.0),
        parameter(published, "publish.field_hz", 0.0),
        parameter(published, "source", "other"),
        parameter(published, "tracking.disc.process_px_s2", 1.0),
    ]
    results = ask(published, "set_parameters", parameters=given).results
    assert [one.successful for one in results] == [True, False, False, False]
    assert "1 to 10000" in results[1].reason
    assert "fixed" in results[2].reason
    (event,) = wait_for(lambda: events.take(8), "no event")
    assert event.node == "/hand/left"
    (changed,) = event.changed_parameters
    assert (changed.name, changed.value.double_value) == ("publish.field_hz", 20.0)
    fields = published.reader("rt/hand/left/field", "sensor_msgs/msg/PointCloud2")
    found: list[Any] = []
    wait_for(lambda: found.extend(fields.take(100)) or len(found) > 9, "no fields")
    stamps = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in found]
    # The change is applied after the first frame.
    assert {b - a for a, b in pairwise(stamps[1:])} == {50_000_000}


def test_a_tracker_is_tuned_and_camera_info_is_kept_for_who_comes_late(tmp_path: Path) -> None:
    folder = record_circling(tmp_path)
    calibration = str(folder / "calibration.json")
    given = [str(tmp_path), "--calibration", calibration, "--domain", str(domain(other=1))]
    options = ["--rate-hz", "100", "--release", "humble", "--wait-s", "120"]
    command = [sys.executable, "-m", "spikingtac", "ros2", *given, *options]
    process = subprocess.Popen(command)
    try:
        with joined(domain(other=1), "HUMBLE") as client:
            (node,) = told(client).node_entities_info_seq
            assert (node.node_namespace, node.node_name) == ("/", "tactile")
            info = client.reader(
                "rt/tactile/camera_info", "sensor_msgs/msg/CameraInfo", latched=True
            )
            (known,) = wait_for(lambda: info.take(1), "no camera info")
            assert (known.width, known.height) == open_circling().calibration.size
            assert (known.distortion_model, list(known.d)) == ("", [])
            assert list(known.k) == [0.0] * 9
            asked = {"prefixes": ["tracking"], "depth": 0}
            kind = "rcl_interfaces/ListParameters"
            names = client.ask("/tactile/list_parameters", kind, **asked).result.names
            assert "tracking.hysteresis" in names
            change = [parameter(client, "tracking.hysteresis", "anchored")]
            kind = "rcl_interfaces/SetParameters"
            (done,) = client.ask("/tactile/set_parameters", kind, parameters=change).results
            assert done.successful
            kept = client.reader("rt/tactile/field", "sensor_msgs/msg/PointCloud2")
            assert wait_for(lambda: kept.take(1), "no field")
            assert process.wait(60) == 0  # with the other tracker to the end
    finally:
        process.kill()
        process.communicate()
