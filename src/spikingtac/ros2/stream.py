"""What is published of a sensor: which topics, how often, and with which times."""

import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.ros2.messages import NS_PER_US, Publisher, header
from spikingtac.touch.detector import TouchDetector
from spikingtac.types import US_PER_S, EventPacket, MarkerFrame

TOPIC_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")  # Absolute name of a topic.

# Topic -> its message.
TOPICS = {
    "field": "sensor_msgs/PointCloud2",
    "arrows": "visualization_msgs/MarkerArray",
    "contact": "std_msgs/Bool",
    "wrench": "geometry_msgs/WrenchStamped",
    "events": "event_camera_msgs/EventPacket",
    "camera_info": "sensor_msgs/CameraInfo",
    "diagnostics": "diagnostic_msgs/DiagnosticArray",
}
STATES = ("contact", "camera_info")  # Topics whose last message is kept for those who come later.
PLAIN = ("arrows", "contact")  # Messages without a header of their own.
DIAGNOSTICS_US = US_PER_S  # Period of /diagnostics, us; ROS tools call them stale after 5 s.
MOST_HZ = 10_000.0  # Fields per second that the fastest tracker makes.
ARROWS_HZ = 30.0  # Arrows per second: what a display shows.

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


@dataclass(frozen=True, slots=True)
class SensorInfo:
    """A sensor that is published: its markers at rest, and what comes with their frames.

    Attributes:
        reference_px: ``(m, 2)`` rest positions, px.
        grid: Rows and columns; their product is m. None for markers without rows, a single one.
        px_per_mm: Scale, None where it is unknown.
        size_px: Width and height of the image, None where they are unknown.
        name: Its name in /diagnostics.
        has_events: Whether its events are published, too.
        has_wrench: Whether forces and moments are published, too.
    """

    reference_px: NDArray[np.floating]
    grid: tuple[int, int] | None
    px_per_mm: float | None
    size_px: tuple[int, int] | None = None
    name: str = ""
    has_events: bool = False
    has_wrench: bool = False


class SensorStream:
    """Publishes frames and events of a sensor.

    Args:
        publisher: Sends the messages; None for nobody.
        sensor: The sensor.
        prefix: Begins the name of every topic but ``/diagnostics``.
        field_hz: Fields and wrenches per second, at most as many as there are frames.
        clock_ns: Time of day, ns. The first data time becomes this host's time, and the others
            follow as the sensor counts them. None keeps the data times.

    Attributes:
        counts: Topic -> messages sent.
        topics: Topic -> its whole name, of those that are published.

    Raises:
        ConfigError: ``prefix`` is no name of a topic, or ``field_hz`` out of range.
    """

    def __init__(
        self,
        publisher: Publisher | None,
        sensor: SensorInfo,
        *,
        prefix: str = "/tactile",
        field_hz: float = MOST_HZ,
        clock_ns: Callable[[], int] | None = time.time_ns,
    ) -> None:
        if not 1.0 <= field_hz <= MOST_HZ:
            raise ConfigError(f"field_hz is {field_hz:g}, it must be 1 to {MOST_HZ:g}")
        self._publisher, self._sensor, self._field_us = publisher, sensor, US_PER_S / field_hz
        self._clock_ns, self._offset_ns = clock_ns, 0 if clock_ns is None else None
        rest_px = np.asarray(sensor.reference_px, float)
        centre_px = (rest_px.min(axis=0) + rest_px.max(axis=0)) / 2
        if sensor.size_px is not None:
            centre_px = (np.array(sensor.size_px) - 1) / 2
        self._rest_px = rest_px - centre_px
        self._due_us: dict[str, float] = {}
        self._touching: bool | None = None
        self._touches: TouchDetector | None = None
        with suppress(ConfigError):  # too few markers to tell a strain
            self._touches = TouchDetector(rest_px)
        self._encoder, self._origin_us = Evt3Encoder(), 0
        self.counts: Counter[str] = Counter()
        self.topics = _topics(prefix, sensor, can_touch=self._touches is not None)
        if publisher is not None:
            for name, topic in self.topics.items():
                publisher.advertise(topic, TOPICS[name], state=name in STATES)
        if clock_ns is not None:
            self._tell_camera(clock_ns())

    def frame(
        self,
        frame: MarkerFrame,
        wrench: NDArray[np.floating] | None = None,
        figures: Mapping[str, float] | None = None,
    ) -> None:
        """Publish a frame: its field, and whatever else is due.

        Args:
            frame: The frame.
            wrench: Forces (N) and moments (Nm), where they are known.
            figures: What /diagnostics tells of the sensor.
        """
        stamp_ns = self._stamp_ns(frame.t_us)
        if self._due("field", frame.t_us, self._field_us):
            self._send("field", self._field(frame), stamp_ns)
            if wrench is not None:
                force, torque = (
                    dict(zip("xyz", wrench[at : at + 3].tolist(), strict=False)) for at in (0, 3)
                )
                self._send("wrench", {"wrench": {"force": force, "torque": torque}}, stamp_ns)
        if self._touches is not None:
            self._touches.update(frame)
            if self._touches.touching != self._touching:
                self._touching = self._touches.touching
                self._send("contact", {"data": self._touching}, stamp_ns)
        if self._due("arrows", frame.t_us, US_PER_S / ARROWS_HZ):
            self._send("arrows", self._arrows(frame, stamp_ns), stamp_ns)
        if self._due("diagnostics", frame.t_us, DIAGNOSTICS_US):
            self._send("diagnostics", self._diagnosis(frame, stamp_ns, figures or {}), stamp_ns)
            self._tell_camera(stamp_ns)

    def events(self, packet: EventPacket) -> None:
        """Publish events; nothing is sent where there are none."""
        if not self._sensor.has_events or not len(packet):
            return
        if self.counts["events"] == 0:
            self._origin_us = packet.t_start_us
        # One encoder for the whole stream: its words refer to earlier ones.
        words = self._encoder.encode(packet.t - self._origin_us, packet.x, packet.y, packet.p)
        message = {
            "height": packet.size[1],
            "width": packet.size[0],
            "seq": self.counts["events"],
            "time_base": self._origin_us * NS_PER_US,
            "encoding": "evt3",
            "is_bigendian": False,
            "events": words.astype("<u2").tobytes(),
        }
        self._send("events", message, self._stamp_ns(int(packet.t[0])))

    def _field(self, frame: MarkerFrame) -> dict[str, Any]:
        cloud = np.zeros(len(frame.coasted), FIELD)
        rows, columns = self._sensor.grid or (1, len(cloud))
        cloud["x"], cloud["y"] = (self._rest_px / (self._sensor.px_per_mm or 1.0)).T
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

    def _arrows(self, frame: MarkerFrame, stamp_ns: int) -> dict[str, Any]:
        """Return the displacements as lines from rest to place, m."""
        px_per_m = (self._sensor.px_per_mm or 1.0 / DRAWN_MM_PER_PX) * MM_PER_M
        rest_m = self._rest_px / px_per_m
        ends_m = np.stack((rest_m, rest_m + frame.displacement_px / px_per_m), axis=1)
        lines = {
            "header": header(stamp_ns),
            "ns": "displacement",
            "type": LINE_LIST,
            "pose": {"orientation": {"w": 1.0}},
            "scale": {"x": LINE_MM / MM_PER_M},
            "color": {"r": 1.0, "g": 0.6, "b": 0.0, "a": 1.0},
            "points": [{"x": x, "y": y} for x, y in ends_m[~frame.coasted].reshape(-1, 2).tolist()],
        }
        return {"markers": [lines]}

    def _diagnosis(
        self, frame: MarkerFrame, stamp_ns: int, figures: Mapping[str, float]
    ) -> dict[str, Any]:
        now_ns = stamp_ns if self._clock_ns is None else self._clock_ns()
        told = {
            "frames": self.counts["field"],
            "readers": self._publisher.readers(self.topics["field"]) if self._publisher else 0,
            "behind_ms": (now_ns - stamp_ns) / 1e6,
            **figures,
            **frame.health.summary(),
        }
        coasted = int(frame.coasted.sum())
        status = {
            "level": 1 if coasted else 0,
            "name": "spikingtac: tracking",
            "message": f"{coasted} markers held" if coasted else "all markers seen",
            "hardware_id": self._sensor.name,
            "values": [{"key": key, "value": f"{value:g}"} for key, value in told.items()],
        }
        return {"status": [status]}

    def _tell_camera(self, stamp_ns: int) -> None:
        if self._sensor.size_px is not None:
            # The lens was never calibrated: matrices and distortion are zero then, as ROS asks for.
            width, height = map(int, self._sensor.size_px)
            self._send("camera_info", {"width": width, "height": height}, stamp_ns)

    def _send(self, name: str, message: Mapping[str, Any], stamp_ns: int) -> None:
        if self._publisher is not None:
            whole = message if name in PLAIN else {**message, "header": header(stamp_ns)}
            self._publisher.publish(self.topics[name], whole, stamp_ns)
        self.counts[name] += 1

    def _due(self, name: str, t_us: int, period_us: float) -> bool:
        due_us = self._due_us.get(name, t_us)
        if t_us < due_us:
            return False
        # The rate is kept on a coarser grid of frames; after a gap it starts anew.
        self._due_us[name] = (due_us if t_us - due_us < period_us else t_us) + period_us
        return True

    def _stamp_ns(self, t_us: int) -> int:
        if self._offset_ns is None and self._clock_ns is not None:
            self._offset_ns = self._clock_ns() - t_us * NS_PER_US
        return t_us * NS_PER_US + (self._offset_ns or 0)


def _topics(prefix: str, sensor: SensorInfo, *, can_touch: bool) -> dict[str, str]:
    """Return the whole names of the topics that a sensor fills.

    Raises:
        ConfigError: The prefix is no name of a topic.
    """
    if not TOPIC_NAME.fullmatch(prefix):
        raise ConfigError(
            f"{prefix!r} is no name of a topic; valid are letters, digits and _ between "
            "slashes, as /tactile/left"
        )
    absent = {
        "contact": not can_touch,
        "wrench": not sensor.has_wrench,
        "events": not sensor.has_events,
        "camera_info": sensor.size_px is None,
    }
    return {
        name: "/diagnostics" if name == "diagnostics" else f"{prefix}/{name}"
        for name in TOPICS
        if not absent.get(name, False)
    }
