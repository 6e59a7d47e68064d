"""ROS 2 message types: definitions, hashes and bytes, from the definitions that rosbags holds.

Messages are given as mappings; what is missing is zero or empty. Type names are short, as
``std_msgs/Bool``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from spikingtac.errors import MissingExtraError

# Definition of event_camera_msgs/EventPacket (ros-event-camera/event_camera_msgs).
EVENT_PACKET = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events"
)

# Types of one byte; since ROS 2 they are uint8 on the wire (rosidl_adapter).
OCTETS = ("octet", "char", "byte")


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
    return bytes(_store().serialize_cdr(_filled(name, values), name))


def definition(message: str) -> str:
    """Return a message's definition with all that it refers to, as bags and MCAP files hold it."""
    return _store().generate_msgdef(ros_type(message), ros_version=2)[0]


def type_hash(message: str) -> str:
    """Return the hash of a type as ROS 2 writes it since Iron, ``RIHS01_...`` (REP-2016)."""
    return _store().hash_rihs01(ros_type(message))


def ros_type(message: str) -> str:
    """Return the name of a type in ROS 2, as ``std_msgs/msg/Bool``."""
    return message.replace("/", "/msg/")


@cache
def idl_struct(message: str) -> Any:
    """Return Cyclone DDS's type of a message, named as on the wire."""
    return _idl_struct(ros_type(message))


def sample(message: str, values: Mapping[str, Any]) -> Any:
    """Return a message for Cyclone DDS to write, with its bytes ready.

    The library's own encoder takes five times as long.
    """
    kind = idl_struct(message)
    made = kind.__new__(kind)
    encoded = encode(message, values)
    object.__setattr__(made, "serialize", lambda **_: encoded)
    return made


@cache
def _store() -> Any:
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise MissingExtraError(
            "ROS 2 messages need rosbags; install it with: pip install 'spikingtac[ros2]'"
        ) from error
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(EVENT_PACKET, "event_camera_msgs/msg/EventPacket"))
    return store


def _filled(name: str, values: Mapping[str, Any]) -> Any:
    """Return rosbags's object of a message."""
    fields = dict(_store().fielddefs[name][1])
    if unknown := set(values) - set(fields):
        raise KeyError(f"{name} has no field {sorted(unknown)[0]!r}")
    return _store().types[name](
        **{field: _value(node, values.get(field)) for field, node in fields.items()}
    )


def _value(node: Any, value: Any) -> Any:
    from rosbags.interfaces import Nodetype

    kind, what = node
    if kind == Nodetype.NAME:
        return _filled(what, value or {})
    if kind == Nodetype.BASE:
        empty = "" if what[0] == "string" else False if what[0] == "bool" else 0
        return empty if value is None else value
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


def _idl_struct(name: str) -> Any:
    from cyclonedds.idl import make_idl_struct

    package, _, short = name.split("/")
    fields = {field: _idl(node) for field, node in _store().fielddefs[name][1]}
    return make_idl_struct(f"{short}_", f"{package}::msg::dds_::{short}_", fields)


def _idl(node: Any) -> Any:
    from cyclonedds.idl import types
    from rosbags.interfaces import Nodetype

    kind, what = node
    if kind == Nodetype.NAME:
        return _idl_struct(what)
    if kind == Nodetype.BASE:
        own = {"string": str, "bool": bool} | dict.fromkeys(OCTETS, types.uint8)
        return own[what[0]] if what[0] in own else getattr(types, what[0])
    inner, length = _idl(what[0]), what[1]
    return types.array[inner, length] if kind == Nodetype.ARRAY else types.sequence[inner]
