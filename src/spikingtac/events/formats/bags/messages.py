"""The storages of ROS bags, as raw messages of given types: sqlite3, MCAP, ROS 1."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from spikingtac.errors import FormatError
from spikingtac.events.formats.bags.raw_message import Count, RawMessage


def messages_of(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: The file is no bag, or claims more than an input may.
        MissingExtraError: The storage needs a library that is not installed.
    """
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"SQLite"):
        from spikingtac.events.formats.bags.ros2_database import database_messages

        return database_messages(path, types, count)
    if start.startswith(b"\x89MCAP"):
        from spikingtac.events.formats.bags.mcap import mcap_messages

        return mcap_messages(path, types, count)
    if start.startswith(b"#ROSBAG"):
        from spikingtac.events.formats.bags.ros1 import ros1_messages

        return ros1_messages(path, types, count)
    raise FormatError(
        f"{str(path)!r} begins like no bag (valid: ROS 2 sqlite3 .db3, .mcap, ROS 1 .bag)"
    )
