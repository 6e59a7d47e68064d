"""What is published of a sensor: which topics, how often, and with which times."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import ConfigError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.ros2 import messages
from spikingtac.ros2.messages import NS_PER_US, Layout
from spikingtac.touch.detector import TouchDetector
from spikingtac.touch.touch import TouchConfig
from spikingtac.types import EventPacket, MarkerFrame

US_PER_S = 1_000_000

PREFIX = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")  # Absolute name of a topic.

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

# Frames of the rehearsal: rest, a press of 150 ms, and its release until it is told.
REHEARSED = 600
REHEARSED_STRAIN = 0.08  # Stretch of the skin in the rehearsal's press.


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


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamConfig:
    """What is published.

    Attributes:
        prefix: Begins the name of every topic but ``/diagnostics``.
        hardware: Name of the sensor in /diagnostics.
        events: Publish the events, too.
        wrench: Publish forces and moments, too.
        field_hz: Fields and wrenches per second, at most as many as there are frames.
    """

    prefix: str = "/tactile"
    hardware: str = ""
    events: bool = True
    wrench: bool = False
    field_hz: float = MOST_HZ

    def __post_init__(self) -> None:
        if not PREFIX.fullmatch(self.prefix):
            raise ConfigError(
                f"{self.prefix!r} is no name of a topic; valid are letters, digits and _ between "
                "slashes, as /tactile/left"
            )
        if not 1.0 <= self.field_hz <= MOST_HZ:
            raise ConfigError(f"field_hz is {self.field_hz:g}, it must be 1 to {MOST_HZ:g}")


class SensorStream:
    """Publishes frames and events of a sensor.

    Args:
        publisher: Sends the messages; None for nobody.
        layout: The markers at rest.
        config: What is published.
        clock_ns: Time of day, ns. The first data time becomes this host's time, and the others
            follow as the sensor counts them. None keeps the data times.

    Attributes:
        counts: Topic -> messages sent.
    """

    def __init__(
        self,
        publisher: Publisher | None,
        layout: Layout,
        config: StreamConfig,
        clock_ns: Callable[[], int] | None = time.time_ns,
    ) -> None:
        self._publisher, self._layout, self._config = publisher, layout, config
        self._clock_ns, self._offset_ns = clock_ns, 0 if clock_ns is None else None
        self._due_us: dict[str, float] = {}
        self._touching: bool | None = None
        self._touches: TouchDetector | None = None
        with suppress(ConfigError):  # too few markers to tell a strain
            self._touches = TouchDetector(np.asarray(layout.reference_px, float), TouchConfig())
        self._encoder, self._origin_us = Evt3Encoder(), 0
        self.counts: Counter[str] = Counter()
        absent = {
            "contact": self._touches is None,
            "wrench": not config.wrench,
            "events": not config.events,
            "camera_info": layout.size_px is None,
        }
        self._topics = {
            name: "/diagnostics" if name == "diagnostics" else f"{config.prefix}/{name}"
            for name in TOPICS
            if not absent.get(name, False)
        }
        if publisher is not None:
            for name, topic in self._topics.items():
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
        if self._due("field", frame.t_us, US_PER_S / self._config.field_hz):
            self._send("field", messages.field_message(frame, self._layout), stamp_ns)
            if wrench is not None:
                self._send("wrench", messages.wrench_message(wrench), stamp_ns)
        if self._touches is not None:
            self._touches.update(frame)
            if self._touches.touching != self._touching:
                self._touching = self._touches.touching
                self._send("contact", {"data": self._touching}, stamp_ns)
        if self._due("arrows", frame.t_us, US_PER_S / ARROWS_HZ):
            self._send("arrows", messages.arrows_message(frame, self._layout, stamp_ns), stamp_ns)
        if self._due("diagnostics", frame.t_us, DIAGNOSTICS_US):
            self._diagnose(frame, stamp_ns, figures or {})
            self._tell_camera(stamp_ns)

    def events(self, packet: EventPacket) -> None:
        """Publish events; nothing is sent where there are none."""
        if not self._config.events or not len(packet):
            return
        if self.counts["events"] == 0:
            self._origin_us = packet.t_start_us
        message = messages.events_message(packet, self._encoder, self._origin_us)
        message["seq"] = self.counts["events"]
        self._send("events", message, self._stamp_ns(int(packet.t[0])))

    def _tell_camera(self, stamp_ns: int) -> None:
        if self._layout.size_px is not None:
            # The lens was never calibrated: matrices and distortion are zero then, as ROS asks for.
            width, height = map(int, self._layout.size_px)
            self._send("camera_info", {"width": width, "height": height}, stamp_ns)

    def _diagnose(self, frame: MarkerFrame, stamp_ns: int, figures: Mapping[str, float]) -> None:
        readers = 0 if self._publisher is None else self._publisher.readers(self._topics["field"])
        now_ns = stamp_ns if self._clock_ns is None else self._clock_ns()
        told = {
            "frames": self.counts["field"],
            "readers": readers,
            "behind_ms": (now_ns - stamp_ns) / 1e6,
            **figures,
            **frame.health.summary(),
        }
        coasted = int(frame.coasted.sum())
        message = messages.diagnostics_message(self._config.hardware, coasted, told)
        self._send("diagnostics", message, stamp_ns)

    def _send(self, name: str, message: Mapping[str, Any], stamp_ns: int) -> None:
        if self._publisher is not None:
            whole = message if name in PLAIN else {**message, "header": messages.header(stamp_ns)}
            self._publisher.publish(self._topics[name], whole, stamp_ns)
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


def rehearse(layout: Layout) -> None:
    """Publish a press without readers, so that nothing is left to compile at the first frame.

    Without, the first frames leave late: by a second, measured on tracks of 64 markers.
    """
    rest_px = np.asarray(layout.reference_px, np.float64)
    away_px = REHEARSED_STRAIN * (rest_px - rest_px.mean(axis=0))
    none, sure = np.zeros(len(rest_px), bool), np.ones(len(rest_px))
    stream = SensorStream(None, layout, StreamConfig(events=False))
    for step in range(REHEARSED):
        moved_px = away_px * (REHEARSED // 4 <= step < REHEARSED // 2)
        place_px = rest_px + moved_px
        stream.frame(MarkerFrame(step * 1_000, place_px, place_px, moved_px, none, sure))
