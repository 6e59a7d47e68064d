"""A tracked stretch as MCAP with ROS 2 schemas: events, displacement field, image, diagnostics.

ROS 2 tools, Foxglove and Rerun read it without ROS being installed here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import MissingExtraError
from spikingtac.events.formats.evt.encode.evt3 import Evt3Encoder
from spikingtac.live.playback import Playback
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.export.ros_messages import DEFINITIONS, FLOAT32
from spikingtac.viewer.export.stretch import US_PER_S, Stretch, open_stretch
from spikingtac.viewer.session.layers import grey_image
from spikingtac.viewer.session.source import ViewSource

MESSAGE_US = 10_000
"""Span of a message: 100 per second, what a display needs and a bag likes."""
NS_PER_US = 1_000
FRAME = "tactile_sensor"
TYPES = {
    "events": "event_camera_msgs/msg/EventPacket",
    "field": "sensor_msgs/msg/PointCloud2",
    "image": "sensor_msgs/msg/Image",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Topic -> its message type."""
FIELD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "u", "v", "du", "dv", "valid")])
"""A marker: rest position in mm about the image's centre (px where the scale is unknown), position
u, v and displacement du, dv in px, and 1 where it was seen."""


def export_mcap(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write what a page would show; return the number of messages.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: File to write.
        seconds: Length of the stretch; None is all of it, where the source ends.

    Raises:
        MissingExtraError: The extra ``[formats]`` is not installed.
        ConfigError: The source does not end and no length was given.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingExtraError("MCAP needs: pip install 'spikingtac[formats]'") from error
    with open_stretch(view, seconds) as stretch, open(path, "wb") as file:
        writer = Writer(file)
        messages = _write(_Topics(writer), stretch)
        writer.finish()
    return messages


def _write(topics: _Topics, stretch: Stretch) -> int:
    playback, encoder = stretch.playback, Evt3Encoder()
    store, start_us = playback.store, playback.position_us
    while start_us < stretch.end_us:
        advanced_us = stretch.advance(MESSAGE_US)
        now_us = start_us + advanced_us
        # The events after the last whole step belong to the last message.
        last = advanced_us < MESSAGE_US
        packet = store.between(start_us, stretch.end_us if last else now_us)
        topics.write("events", now_us, _events(packet, encoder, store.t_start_us))
        if playback.frame is not None:
            topics.write(
                "field", playback.frame.t_us, _field(playback.frame, stretch.view.calibration)
            )
        topics.write("image", now_us, _image(stretch.exposed()))
        topics.write("diagnostics", now_us, _diagnostics(stretch.view, playback))
        if last:
            break
        start_us = now_us
    return topics.written


class _Topics:
    """The four topics of a file."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas = {
            name: writer.register_msgdef(kind, DEFINITIONS[kind]) for name, kind in TYPES.items()
        }
        self._counts = dict.fromkeys(TYPES, 0)

    @property
    def written(self) -> int:
        """Messages written so far."""
        return sum(self._counts.values())

    def write(self, name: str, t_us: int, message: dict[str, Any]) -> None:
        """Append a message, stamped with its data time."""
        stamp = {"sec": t_us // US_PER_S, "nanosec": t_us % US_PER_S * NS_PER_US}
        message["header"] = {"stamp": stamp, "frame_id": FRAME}
        if name == "events":
            message["seq"] = self._counts[name]
        t_ns = t_us * NS_PER_US
        topic = "/diagnostics" if name == "diagnostics" else f"/tactile/{name}"
        self._writer.write_message(
            topic, self._schemas[name], message, t_ns, t_ns, self._counts[name]
        )
        self._counts[name] += 1


def _events(packet: EventPacket, encoder: Evt3Encoder, origin_us: int) -> dict[str, Any]:
    words = encoder.encode(packet.t - origin_us, packet.x, packet.y, packet.p)
    return {
        "height": packet.size[1],
        "width": packet.size[0],
        "time_base": origin_us * NS_PER_US,
        "encoding": "evt3",
        "is_bigendian": False,
        "events": words.astype("<u2").tobytes(),
    }


def _field(frame: MarkerFrame, calibration: Calibration) -> dict[str, Any]:
    cloud = np.zeros(len(frame.coasted), FIELD)
    rest = _about_centre(calibration) / (calibration.px_per_mm or 1.0)
    cloud["x"], cloud["y"] = rest.T
    cloud["u"], cloud["v"] = frame.position_px.T
    cloud["du"], cloud["dv"] = frame.displacement_px.T
    cloud["valid"] = ~frame.coasted
    fields = [
        {"name": name, "offset": 4 * index, "datatype": FLOAT32, "count": 1}
        for index, name in enumerate(FIELD.names or ())
    ]
    return {
        "height": calibration.grid[0],
        "width": calibration.grid[1],
        "fields": fields,
        "is_bigendian": False,
        "point_step": FIELD.itemsize,
        "row_step": FIELD.itemsize * calibration.grid[1],
        "data": cloud.tobytes(),
        "is_dense": True,
    }


def _about_centre(calibration: Calibration) -> NDArray[np.float64]:
    return calibration.reference_px - (np.array(calibration.size) - 1) / 2


def _image(exposed: EventPacket) -> dict[str, Any]:
    grey = grey_image(exposed)
    height, width = grey.shape
    return {
        "height": height,
        "width": width,
        "encoding": "mono8",
        "is_bigendian": 0,
        "step": width,
        "data": grey.tobytes(),
    }


def _diagnostics(view: ViewSource, playback: Playback) -> dict[str, Any]:
    p50_us, p99_us = playback.step_percentiles_us()
    figures = {"step_p50_us": p50_us, "step_p99_us": p99_us, **view.source.losses}
    values = [{"key": key, "value": f"{value:g}"} for key, value in figures.items()]
    coasted = int(playback.frame.coasted.sum()) if playback.frame else 0
    status = {
        "level": 1 if coasted else 0,
        "name": "spikingtac: tracking",
        "message": f"{coasted} markers held" if coasted else "all markers seen",
        "hardware_id": view.label,
        "values": values,
    }
    return {"status": [status]}
