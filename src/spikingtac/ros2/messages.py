"""ROS 2 messages as plain mappings, and their types, hashes and bytes as rosbags holds them.

What a mapping leaves out is zero or empty. Type names are short, as ``std_msgs/Bool``.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Protocol

import numpy as np

from spikingtac.errors import import_extra

NS_PER_S, NS_PER_US = 1_000_000_000, 1_000
FRAME_ID = "tactile_sensor"

# Definition of event_camera_msgs/EventPacket (ros-event-camera/event_camera_msgs).
EVENT_PACKET = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events"
)

# Types of one byte; since ROS 2 they are uint8 on the wire (rosidl_adapter).
OCTETS = ("octet", "char", "byte")


class Publisher(Protocol):
    """Sends messages: over DDS, to Foxglove, into a file."""

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic.

        Args:
            topic: Absolute name, as ``/tactile/field``.
            message: Package and name, as ``std_msgs/Bool``.
            state: The last message is kept for those who come later, and is sent for certain.
        """
        ...

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Send a message of a time, ns, without waiting for slow readers."""
        ...

    def readers(self, topic: str) -> int:
        """Return how many readers a topic has now."""
        ...


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    """Return a message as CDR, little endian, with its encapsulation header.

    Args:
        message: Package and name, as ``std_msgs/Bool``.
        values: Field -> value, nested messages as mappings.

    Raises:
        KeyError: A field is unknown.
        ValueError: An array has another length.
        MissingExtraError: rosbags is not installed.
    """
    name = ros_type(message)
    return bytes(type_store().serialize_cdr(_filled(name, values), name))


def definition(message: str) -> str:
    """Return a message's definition with all that it refers to, as bags and MCAP files hold it."""
    return type_store().generate_msgdef(ros_type(message), ros_version=2)[0]


def ros_type(message: str) -> str:
    """Return the name of a type in ROS 2, as ``std_msgs/msg/Bool``."""
    return message.replace("/", "/msg/")


@cache
def type_store() -> Any:
    """Return the message types of ROS 2, as rosbags holds them, and that of event packets.

    Raises:
        MissingExtraError: rosbags is not installed.
    """
    typesys = import_extra("rosbags.typesys", "a message of ROS 2", "foxglove")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    store.register(typesys.get_types_from_msg(EVENT_PACKET, "event_camera_msgs/msg/EventPacket"))
    return store


def _filled(name: str, values: Mapping[str, Any]) -> Any:
    """Return rosbags's object of a message."""
    fields = dict(type_store().fielddefs[name][1])
    if unknown := set(values) - set(fields):
        raise KeyError(f"{name} has no field {sorted(unknown)[0]!r}")
    filled = {field: _value(node, values.get(field)) for field, node in fields.items()}
    return type_store().types[name](**filled)


def _value(node: Any, value: Any) -> Any:
    from rosbags.interfaces import Nodetype

    kind, what = node
    if kind == Nodetype.NAME:
        return _filled(what, value or {})
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(what[0], 0) if value is None else value
    (inner_kind, inner), length = what
    if inner_kind == Nodetype.NAME:
        return [_filled(inner, one) for one in value or ()]
    if inner[0] == "string":
        return list(value or ())
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8)
    fixed = length if kind == Nodetype.ARRAY else 0
    array = np.zeros(fixed) if value is None else np.asarray(value)
    if fixed and len(array) != fixed:
        raise ValueError(f"{len(array)} values, an array of {fixed} is asked for")
    return array.astype(np.uint8 if inner[0] in OCTETS else inner[0])


def header(t_ns: int) -> dict[str, Any]:
    """Return a header with a time, ns."""
    return {"stamp": {"sec": t_ns // NS_PER_S, "nanosec": t_ns % NS_PER_S}, "frame_id": FRAME_ID}
