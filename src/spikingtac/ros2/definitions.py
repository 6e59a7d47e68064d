"""ROS 2 message definitions, as Humble and Jazzy publish them, with names and hashes of types.

The hashes (REP-2016) are those that Jazzy generates from these definitions; Humble sends none. That
of PointCloud2 stands in rcl's own tests (``test_type_hash.cpp``). Constants are left out but those
that are used: they are no part of what is sent, nor of the hash.
"""

from __future__ import annotations

from collections.abc import Iterator

MESSAGES = {
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

HASHES = {
    "sensor_msgs/PointCloud2": "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "visualization_msgs/MarkerArray": (
        "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
    ),
    "geometry_msgs/WrenchStamped": (
        "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
    ),
    "std_msgs/Bool": "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "diagnostic_msgs/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
    "event_camera_msgs/EventPacket": (
        "d6fa176260b1f37e5a40845305315e150a0f18191241eb64f407442aa29844aa"
    ),
}
"""Message that is published -> sha256 of its type's description, version 1."""

FLOAT32 = 7
"""Datatype code of a PointField."""

_BREAK = "=" * 80


def fields_of(message: str) -> Iterator[tuple[str, str]]:
    """Yield type and name of each field of a message, constants left out."""
    for line in MESSAGES[message].splitlines():
        kind, _, name = line.partition(" ")
        if "=" not in name:
            yield kind, name


def parts_of(message: str) -> list[str]:
    """Return the messages that a message is made of, each of them once, the nearest first."""
    found: dict[str, None] = {}
    for kind, _ in fields_of(message):
        inner = kind.removesuffix("[]")
        if inner in MESSAGES:
            found |= dict.fromkeys([inner, *parts_of(inner)])
    return list(found)


def full_definition(message: str) -> str:
    """Return a message's definition with all that it refers to, as bags and MCAP files hold it."""
    nested = (f"{_BREAK}\nMSG: {name}\n{MESSAGES[name]}" for name in parts_of(message))
    return "\n".join((MESSAGES[message], *nested))


def ros_type(message: str) -> str:
    """Return the name of a type in ROS 2, as ``std_msgs/msg/Bool``."""
    return message.replace("/", "/msg/")


def dds_type(message: str) -> str:
    """Return the name of a type on the wire, as ``std_msgs::msg::dds_::Bool_``."""
    package, _, name = message.partition("/")
    return f"{package}::msg::dds_::{name}_"


def type_hash(message: str) -> str:
    """Return the hash of a published type as ROS 2 writes it, ``RIHS01_...``."""
    return f"RIHS01_{HASHES[message]}"
