"""Messages as bytes, read back by rosbags, and hashes that stand in ROS's own tests."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import Stores, get_typestore

from spikingtac.ros2.messages import definition, encode, type_store

# Hash of PointCloud2 as it stands in rcl's own tests, test_type_hash.cpp.
POINT_CLOUD_HASH = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"


def test_the_hash_is_the_one_in_rcl() -> None:
    assert type_store().hash_rihs01("sensor_msgs/msg/PointCloud2") == POINT_CLOUD_HASH


@pytest.mark.parametrize("release", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_given_fields_are_read_back_and_the_rest_is_zero_or_empty(release: Stores) -> None:
    given = {"ns": "é", "points": [{"x": 1.5}, {"y": -2.0}], "pose": {"orientation": {"w": 1.0}}}
    store = get_typestore(release)
    found = store.deserialize_cdr(
        encode("visualization_msgs/Marker", given), "visualization_msgs/msg/Marker"
    )
    assert [(p.x, p.y, p.z) for p in found.points] == [(1.5, 0.0, 0.0), (0.0, -2.0, 0.0)]
    assert (found.ns, found.id, found.pose.orientation.w, found.text) == ("é", 0, 1.0, "")


def test_bytes_and_arrays_keep_their_values() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    k = [float(n) for n in range(9)]
    info = encode("sensor_msgs/CameraInfo", {"k": k, "d": [0.5]})
    found = store.deserialize_cdr(info, "sensor_msgs/msg/CameraInfo")
    assert (found.k.tolist(), found.d.tolist(), found.p.tolist()) == (k, [0.5], [0.0] * 12)
    image = encode("sensor_msgs/Image", {"data": b"\x00\x07\xff", "width": 3})
    read = store.deserialize_cdr(image, "sensor_msgs/msg/Image")
    np.testing.assert_array_equal(read.data, [0, 7, 255])


def test_unknown_fields_and_arrays_of_another_length_are_refused() -> None:
    with pytest.raises(KeyError, match="no field 'colour'"):
        encode("visualization_msgs/Marker", {"colour": 1})
    with pytest.raises(ValueError, match="2 values, an array of 9"):
        encode("sensor_msgs/CameraInfo", {"k": [1.0, 2.0]})


def test_a_definition_holds_what_it_refers_to() -> None:
    text = definition("event_camera_msgs/EventPacket")
    assert text.startswith("std_msgs/Header header")
    assert "MSG: builtin_interfaces/Time" in text
