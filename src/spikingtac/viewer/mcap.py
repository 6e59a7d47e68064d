"""A tracked stretch as MCAP with ROS 2 schemas: events, displacement field, image, diagnostics.

ROS 2 tools, Foxglove and Rerun read it without ROS being installed here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import MissingExtraError
from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.ros2.messages import (
    NS_PER_US,
    Layout,
    diagnostics_message,
    events_message,
    field_message,
    header,
)
from spikingtac.ros2.types import definition, ros_type
from spikingtac.types import EventPacket
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.record import EXPOSURE_US
from spikingtac.viewer.snapshot import OFF_CODE, activity
from spikingtac.viewer.source import ViewSource

MESSAGE_US = 10_000  # Span of a message: 100 per second, what a display needs and a bag likes.

# Grey values of a pixel without event, and of one whose last event was ON or OFF.
GREY, ON_GREY, OFF_GREY = 128, 255, 0

# Topic -> its message.
TYPES = {
    "events": "event_camera_msgs/EventPacket",
    "field": "sensor_msgs/PointCloud2",
    "image": "sensor_msgs/Image",
    "diagnostics": "diagnostic_msgs/DiagnosticArray",
}


def export_mcap(stretch: Any, path: Path) -> int:
    """Track a stretch and write what a page would show; return the number of messages.

    Raises:
        MissingExtraError: The extra ``[formats]`` is not installed.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingExtraError("MCAP needs: pip install 'spikingtac[formats]'") from error
    with open(path, "wb") as file:
        writer = Writer(file)
        messages = _write(_Topics(writer), stretch)
        writer.finish()
    return messages


def _write(topics: _Topics, stretch: Any) -> int:
    playback, encoder = stretch.playback, Evt3Encoder()
    store, start_us = playback.store, playback.position_us
    layout = _layout(stretch.view.calibration)
    while start_us < stretch.end_us:
        advanced_us = stretch.advance(MESSAGE_US)
        now_us = start_us + advanced_us
        # The events after the last whole step belong to the last message.
        last = advanced_us < MESSAGE_US
        packet = store.between(start_us, stretch.end_us if last else now_us)
        topics.write("events", now_us, events_message(packet, encoder, store.t_start_us))
        if playback.frame is not None:
            topics.write("field", playback.frame.t_us, field_message(playback.frame, layout))
        topics.write("image", now_us, _image(store.between(now_us - EXPOSURE_US, now_us)))
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
            name: writer.register_msgdef(ros_type(message), definition(message))
            for name, message in TYPES.items()
        }
        self._counts = dict.fromkeys(TYPES, 0)

    @property
    def written(self) -> int:
        """Messages written so far."""
        return sum(self._counts.values())

    def write(self, name: str, t_us: int, message: dict[str, Any]) -> None:
        """Append a message, stamped with its data time."""
        t_ns = t_us * NS_PER_US
        message["header"] = header(t_ns)
        if name == "events":
            message["seq"] = self._counts[name]
        topic = "/diagnostics" if name == "diagnostics" else f"/tactile/{name}"
        self._writer.write_message(
            topic, self._schemas[name], message, t_ns, t_ns, self._counts[name]
        )
        self._counts[name] += 1


def _layout(calibration: Calibration) -> Layout:
    return Layout.of_image(
        calibration.reference_px, calibration.grid, calibration.size, calibration.px_per_mm
    )


def _image(exposed: EventPacket) -> dict[str, Any]:
    codes = activity(exposed)
    grey = np.where(codes == 0, GREY, np.where(codes < OFF_CODE, ON_GREY, OFF_GREY))
    height, width = grey.shape
    return {
        "height": height,
        "width": width,
        "encoding": "mono8",
        "is_bigendian": 0,
        "step": width,
        "data": grey.astype(np.uint8).tobytes(),
    }


def _diagnostics(view: ViewSource, playback: Playback) -> dict[str, Any]:
    p50_us, p99_us = playback.step_percentiles_us()
    figures = {"step_p50_us": p50_us, "step_p99_us": p99_us, **view.source.losses}
    coasted = int(playback.frame.coasted.sum()) if playback.frame else 0
    return diagnostics_message(view.label, coasted, figures)
