"""Definitions, hashes and bytes against rosbags, which holds ROS 2's own published definitions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spikingtac.ros2.wire.cdr import encode
from spikingtac.ros2.wire.definitions import (
    MESSAGES,
    dds_type,
    element,
    fields_of,
    full_definition,
    parts_of,
    ros_type,
)
from spikingtac.ros2.wire.service_definitions import SERVICE_PARTS
from spikingtac.ros2.wire.type_hash import type_hash

typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")

FOREIGN = "event_camera_msgs/EventPacket"
"""Not one of ROS 2's own: its definition is that of ros-event-camera/event_camera_msgs."""
IN_RCL = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
"""Hash of PointCloud2 as it stands in rcl's own tests, test_type_hash.cpp."""


def published(release: str) -> Any:
    store = typesys.get_typestore(getattr(typesys.Stores, f"ROS2_{release}"))
    own = typesys.get_types_from_msg(MESSAGES[FOREIGN], ros_type(FOREIGN))
    store.register(own)
    return store


@pytest.fixture(scope="module", params=["HUMBLE", "JAZZY"])
def store(request: pytest.FixtureRequest) -> Any:
    return published(request.param)


@pytest.mark.parametrize("message", sorted(MESSAGES))
def test_hashes_are_those_of_the_published_definitions(store: Any, message: str) -> None:
    assert type_hash(message) == store.hash_rihs01(ros_type(message))


@pytest.mark.parametrize("part", sorted(SERVICE_PARTS))
def test_hashes_of_services_are_those_of_their_definitions(store: Any, part: str) -> None:
    as_message = part.replace("/", "/srv/")
    (_, (_, fields)) = typesys.get_types_from_msg(SERVICE_PARTS[part], as_message).popitem()
    # The library makes messages of them: only the folder in the name differs.
    store.fielddefs[as_message] = ([], fields)
    assert type_hash(part) == store.hash_rihs01(as_message)


def test_what_participants_tell_is_as_published() -> None:
    for release, size in (("HUMBLE", 24), ("JAZZY", 16)):
        known = typesys.get_typestore(getattr(typesys.Stores, f"ROS2_{release}")).fielddefs
        ((_, ((_, _), length)),) = (node for _, node in known["rmw_dds_common/msg/Gid"][1])
        suffix = "@humble" if release == "HUMBLE" else ""
        assert length == size
        assert list(fields_of(f"rmw_dds_common/Gid{suffix}")) == [(f"char[{size}]", "data")]
        for name in ("NodeEntitiesInfo", "ParticipantEntitiesInfo"):
            ours = [field for _, field in fields_of(f"rmw_dds_common/{name}{suffix}")]
            assert ours == [field for field, _ in known[f"rmw_dds_common/msg/{name}"][1]]
            assert dds_type(f"rmw_dds_common/{name}{suffix}") == (
                f"rmw_dds_common::msg::dds_::{name}_"
            )


def test_kinds_of_fields() -> None:
    assert element("float64") == ("float64", None, None)
    assert element("float64[9]") == ("float64", 9, None)
    assert element("uint8[]") == ("uint8", 0, 0)
    assert element("a/B[<=4]") == ("a/B", 0, 4)


def test_an_array_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="2 values, an array of 9"):
        encode("sensor_msgs/CameraInfo", {"k": [1.0, 2.0]})


def test_one_hash_stands_in_rcl() -> None:
    assert type_hash("sensor_msgs/PointCloud2") == IN_RCL


@pytest.mark.parametrize("message", sorted(MESSAGES))
def test_definitions_are_the_published_ones(store: Any, message: str) -> None:
    ours = typesys.get_types_from_msg(full_definition(message), ros_type(message))
    for name, (_, fields) in ours.items():
        assert fields == store.fielddefs[name][1], name


def test_names_on_the_wire() -> None:
    assert dds_type("std_msgs/Bool") == "std_msgs::msg::dds_::Bool_"
    assert list(fields_of("std_msgs/Bool")) == [("bool", "data")]
    assert parts_of("std_msgs/Header") == ["builtin_interfaces/Time"]


def filled(message: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return random values for every field of a message."""
    return {name: value(kind, rng) for kind, name in fields_of(message)}


def value(kind: str, rng: np.random.Generator) -> Any:
    if kind == "uint8[]":
        return rng.bytes(int(rng.integers(0, 9)))
    inner, length, bound = element(kind)
    if length is not None:
        count = length or int(rng.integers(0, (bound or 3) + 1))
        return [value(inner, rng) for _ in range(count)]
    if kind in MESSAGES:
        return filled(kind, rng)
    if kind == "string":
        return "é" * int(rng.integers(0, 6))
    if kind == "bool":
        return bool(rng.integers(0, 2))
    if kind.startswith("float"):
        return float(np.float32(rng.normal()))
    return int(rng.integers(0, 120))


def plain(found: Any) -> Any:
    if isinstance(found, np.ndarray):
        return found.tobytes() if found.dtype == np.uint8 else found.tolist()
    if isinstance(found, list):
        return [plain(item) for item in found]
    if hasattr(found, "__dataclass_fields__"):
        names = (name for name in found.__dataclass_fields__ if name.islower() and name[0] != "_")
        return {name: plain(getattr(found, name)) for name in names}
    return found


@pytest.mark.parametrize("message", sorted(MESSAGES))
def test_bytes_are_read_by_another_library(store: Any, message: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        given = filled(message, rng)
        found = store.deserialize_cdr(encode(message, given), ros_type(message))
        assert plain(found) == given


def test_what_is_not_given_is_empty_and_what_is_unknown_is_refused(store: Any) -> None:
    name = "visualization_msgs/Marker"
    found = store.deserialize_cdr(encode(name, {"ns": "a"}), ros_type(name))
    assert (found.ns, found.id, found.points, found.pose.position.x) == ("a", 0, [], 0.0)
    with pytest.raises(KeyError, match="no field 'colour'"):
        encode(name, {"colour": 1})
