"""ROS 2 message definitions, as Humble and Jazzy publish them, and the names of their types.

Constants are left out but those that are used: they are no part of what is sent, nor of a type's
hash.
"""

from __future__ import annotations

from collections.abc import Iterator

from spikingtac.ros2.wire.service_definitions import (
    HUMBLE,
    NODE_MESSAGES,
    PARAMETER_MESSAGES,
    SERVICE_PARTS,
)

MESSAGES = {
    **PARAMETER_MESSAGES,
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Bool": "bool data",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "sensor_msgs/PointField": (
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n"
        "uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\n"
        "uint8 datatype\nuint32 count"
    ),
    "sensor_msgs/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
    "sensor_msgs/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "sensor_msgs/RegionOfInterest": (
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
    ),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
        "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\n"
        "uint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\n"
        "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": (
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status"
    ),
    "event_camera_msgs/EventPacket": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
        "string encoding\nbool is_bigendian\nuint8[] events"
    ),
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
        "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
        "bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}
"""Package and name of a message -> its definition."""
ALL = {**MESSAGES, **SERVICE_PARTS, **NODE_MESSAGES}
"""The messages, the parts of services, and what participants tell each other."""

FLOAT32 = 7
"""Datatype code of a PointField."""

_BREAK = "=" * 80


def fields_of(message: str) -> Iterator[tuple[str, str]]:
    """Yield type and name of each field of a message, constants left out."""
    for line in ALL[message].splitlines():
        kind, _, name = line.partition(" ")
        if "=" not in name:
            yield kind, name


def element(kind: str) -> tuple[str, int | None, int | None]:
    """Return the type of a field's elements, the length of an array, and a sequence's bound.

    A single value has neither; the length of a sequence is 0, and so is its bound where it has
    none: ``float64[9]`` is ``("float64", 9, None)``, ``uint8[<=4]`` is ``("uint8", 0, 4)``.
    """
    inner, bracket, count = kind.partition("[")
    if not bracket:
        return kind, None, None
    count = count.removesuffix("]")
    bound = count.removeprefix("<=")
    return (inner, 0, int(bound or 0)) if bound != count or not count else (inner, int(count), None)


def parts_of(message: str) -> list[str]:
    """Return the messages that a message is made of, each of them once, the nearest first."""
    found: dict[str, None] = {}
    for kind, _ in fields_of(message):
        inner = element(kind)[0]
        if inner in ALL:
            found |= dict.fromkeys([inner, *parts_of(inner)])
    return list(found)


def full_definition(message: str) -> str:
    """Return a message's definition with all that it refers to, as bags and MCAP files hold it."""
    nested = (f"{_BREAK}\nMSG: {name}\n{ALL[name]}" for name in parts_of(message))
    return "\n".join((ALL[message], *nested))


def ros_type(message: str) -> str:
    """Return the name of a type in ROS 2, as ``std_msgs/msg/Bool``."""
    return message.removesuffix(HUMBLE).replace("/", f"/{_folder(message)}/")


def dds_type(message: str) -> str:
    """Return the name of a type on the wire, as ``std_msgs::msg::dds_::Bool_``."""
    package, _, name = message.removesuffix(HUMBLE).partition("/")
    return f"{package}::{_folder(message)}::dds_::{name}_"


def _folder(message: str) -> str:
    return "srv" if message in SERVICE_PARTS else "msg"
