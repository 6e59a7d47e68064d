"""ROS 2 message definitions, as MCAP files carry them: the message, then what it refers to."""

from __future__ import annotations

_BREAK = "=" * 80
_TIME = "int32 sec\nuint32 nanosec"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
_FIELD = (
    "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n"
    "uint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count"
)
_STATUS = (
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n"
    "string hardware_id\ndiagnostic_msgs/KeyValue[] values"
)
FLOAT32 = 7
"""Datatype code of a PointField."""

_WITH_HEADER = {"std_msgs/Header": _HEADER, "builtin_interfaces/Time": _TIME}


def _definition(text: str, parts: dict[str, str]) -> str:
    nested = (f"{_BREAK}\nMSG: {name}\n{body}" for name, body in {**parts, **_WITH_HEADER}.items())
    return "\n".join((text, *nested))


DEFINITIONS = {
    "event_camera_msgs/msg/EventPacket": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
        "string encoding\nbool is_bigendian\nuint8[] events",
        {},
    ),
    "sensor_msgs/msg/PointCloud2": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
        {"sensor_msgs/PointField": _FIELD},
    ),
    "sensor_msgs/msg/Image": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data",
        {},
    ),
    "diagnostic_msgs/msg/DiagnosticArray": _definition(
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
        {
            "diagnostic_msgs/DiagnosticStatus": _STATUS,
            "diagnostic_msgs/KeyValue": "string key\nstring value",
        },
    ),
}
"""Type -> text, for ``register_msgdef``."""
