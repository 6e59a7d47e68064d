"""ROS 2 messages as plain mappings, and their types, hashes and bytes as rosbags holds them.

What a mapping leaves out is zero or empty. Type names are short, as ``std_msgs/Bool``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import MissingExtraError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.types import EventPacket, MarkerFrame

NS_PER_S, NS_PER_US = 1_000_000_000, 1_000
FRAME_ID = "tactile_sensor"

# A marker: rest position in mm about the image's centre (px where the scale is unknown), position
# u, v and displacement du, dv in px, and 1 where it was seen.
FIELD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "u", "v", "du", "dv", "valid")])
FLOAT32 = 7  # Datatype code of a PointField.
POINT_FIELDS = [
    {"name": name, "offset": 4 * index, "datatype": FLOAT32, "count": 1}
    for index, name in enumerate(FIELD.names or ())
]
MM_PER_M = 1_000.0
DRAWN_MM_PER_PX = 0.1  # Scale of the arrows in RViz where none is known.
LINE_LIST = 5  # Kind of a Marker: a line for each two points.
LINE_MM = 0.08  # Width of an arrow's line, mm.

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


@dataclass(frozen=True, slots=True)
class Layout:
    """The markers at rest, and how they are laid out.

    Attributes:
        reference_px: ``(m, 2)`` rest positions, px.
        grid: Rows and columns; their product is m. None for markers without rows, a single one.
        px_per_mm: Scale, None where it is unknown.
        size_px: Width and height of the image, None where they are unknown.
    """

    reference_px: NDArray[np.floating]
    grid: tuple[int, int] | None
    px_per_mm: float | None
    size_px: tuple[int, int] | None = None

    @property
    def centre_px(self) -> NDArray[np.floating]:
        """``(x, y)`` of the image's centre; the markers' middle where no image is known, px."""
        if self.size_px is not None:
            return (np.array(self.size_px) - 1) / 2
        return (self.reference_px.min(axis=0) + self.reference_px.max(axis=0)) / 2


def header(t_ns: int) -> dict[str, Any]:
    """Return a header with a time, ns."""
    stamp = {"sec": t_ns // NS_PER_S, "nanosec": t_ns % NS_PER_S}
    return {"stamp": stamp, "frame_id": FRAME_ID}


def field_message(frame: MarkerFrame, layout: Layout) -> dict[str, Any]:
    """Return the displacement field of a frame as a PointCloud2, without header."""
    cloud = np.zeros(len(frame.coasted), FIELD)
    rows, columns = layout.grid or (1, len(cloud))
    rest = (layout.reference_px - layout.centre_px) / (layout.px_per_mm or 1.0)
    cloud["x"], cloud["y"] = rest.T
    cloud["u"], cloud["v"] = frame.position_px.T
    cloud["du"], cloud["dv"] = frame.displacement_px.T
    cloud["valid"] = ~frame.coasted
    return {
        "height": rows,
        "width": columns,
        "fields": POINT_FIELDS,
        "is_bigendian": False,
        "point_step": FIELD.itemsize,
        "row_step": FIELD.itemsize * columns,
        "data": cloud.tobytes(),
        "is_dense": True,
    }


def arrows_message(frame: MarkerFrame, layout: Layout, t_ns: int) -> dict[str, Any]:
    """Return the displacements as lines from rest to place, in metres, as a MarkerArray."""
    px_per_m = (layout.px_per_mm or 1.0 / DRAWN_MM_PER_PX) * MM_PER_M
    rest = (layout.reference_px - layout.centre_px) / px_per_m
    ends = np.stack((rest, rest + frame.displacement_px / px_per_m), axis=1)[~frame.coasted]
    lines = {
        "header": header(t_ns),
        "ns": "displacement",
        "type": LINE_LIST,
        "pose": {"orientation": {"w": 1.0}},
        "scale": {"x": LINE_MM / MM_PER_M},
        "color": {"r": 1.0, "g": 0.6, "b": 0.0, "a": 1.0},
        "points": [{"x": x, "y": y} for x, y in ends.reshape(-1, 2).tolist()],
    }
    return {"markers": [lines]}


def wrench_message(values: NDArray[np.floating]) -> dict[str, Any]:
    """Return forces (N) and moments (Nm) as a WrenchStamped, without header."""
    force, torque = (dict(zip("xyz", values[at : at + 3].tolist(), strict=False)) for at in (0, 3))
    return {"wrench": {"force": force, "torque": torque}}


def events_message(packet: EventPacket, encoder: Evt3Encoder, origin_us: int) -> dict[str, Any]:
    """Return events as an EventPacket, without header and number.

    Args:
        packet: The events.
        encoder: One for the whole stream: its words refer to earlier ones.
        origin_us: Time of the stream's beginning, us.
    """
    words = encoder.encode(packet.t - origin_us, packet.x, packet.y, packet.p)
    return {
        "height": packet.size[1],
        "width": packet.size[0],
        "time_base": origin_us * NS_PER_US,
        "encoding": "evt3",
        "is_bigendian": False,
        "events": words.astype("<u2").tobytes(),
    }


def diagnostics_message(
    hardware: str, coasted: int, figures: Mapping[str, float]
) -> dict[str, Any]:
    """Return a DiagnosticArray, without header.

    Args:
        hardware: The sensor.
        coasted: Number of markers that were not seen.
        figures: What else is told, by name.
    """
    status = {
        "level": 1 if coasted else 0,
        "name": "spikingtac: tracking",
        "message": f"{coasted} markers held" if coasted else "all markers seen",
        "hardware_id": hardware,
        "values": [{"key": key, "value": f"{value:g}"} for key, value in figures.items()],
    }
    return {"status": [status]}
