"""MCAP files with ROS 2 schemas; ROS 2 tools, Foxglove and Rerun read them without ROS here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.errors import MissingExtraError
from spikingtac.ros2.messages import definition, encode, header, ros_type
from spikingtac.types import EventPacket
from spikingtac.viewer.snapshot import OFF_CODE, activity

# Grey values of a pixel without event, and of one whose last event was ON or OFF.
GREY, ON_GREY, OFF_GREY = 128, 255, 0


class McapPublisher:
    """Writes messages into a file; it is a :class:`~spikingtac.ros2.stream.Publisher`.

    Args:
        path: The file.

    Attributes:
        messages: Messages written so far.

    Raises:
        MissingExtraError: The extra ``[formats]`` is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise MissingExtraError("MCAP needs: pip install 'spikingtac[formats]'") from error
        self._writer = Writer(str(path))
        self._writer.start(profile="ros2", library="spikingtac")
        self._channels: dict[str, tuple[int, str]] = {}
        self.messages = 0

    def advertise(self, topic: str, message: str, *, state: bool = False) -> None:
        """Announce a topic."""
        text = definition(message).encode()
        schema = self._writer.register_schema(ros_type(message), "ros2msg", text)
        self._channels[topic] = self._writer.register_channel(topic, "cdr", schema), message

    def publish(self, topic: str, values: Mapping[str, Any], t_ns: int) -> None:
        """Append a message, stamped with its data time."""
        channel, message = self._channels[topic]
        self._writer.add_message(channel, t_ns, encode(message, values), t_ns, self.messages)
        self.messages += 1

    def readers(self, topic: str) -> int:
        """Return 1: the file."""
        return 1

    def close(self) -> None:
        """Complete the file."""
        self._writer.finish()


def image_message(exposed: EventPacket, t_ns: int) -> dict[str, Any]:
    """Return events as an Image, as the page shows them: OFF dark, ON bright."""
    codes = activity(exposed)
    grey = np.where(codes == 0, GREY, np.where(codes < OFF_CODE, ON_GREY, OFF_GREY))
    return {
        "header": header(t_ns),
        "height": codes.shape[0],
        "width": codes.shape[1],
        "encoding": "mono8",
        "step": codes.shape[1],
        "data": grey.astype(np.uint8).tobytes(),
    }
