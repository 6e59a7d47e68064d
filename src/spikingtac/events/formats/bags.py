"""The storages of ROS bags, as raw messages of given types: sqlite3, MCAP, ROS 1."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from spikingtac.errors import FormatError, MissingExtraError

Count = Callable[[str], None]
"""Counts one more of a kind of damage."""


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool


def messages_of(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: The file is no bag.
        MissingExtraError: The storage needs a library that is not installed.
    """
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"SQLite"):
        return _sqlite_messages(path, types, count)
    if start.startswith(b"\x89MCAP"):
        return _mcap_messages(path, types, count)
    if start.startswith(b"#ROSBAG"):
        return _ros1_messages(path, types, count)
    raise FormatError(
        f"{str(path)!r} begins like no bag (valid: ROS 2 sqlite3 .db3, .mcap, ROS 1 .bag)"
    )


def _sqlite_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        marks = ",".join("?" * len(types))
        rows = database.execute(
            "SELECT topics.name, messages.data FROM messages "
            "JOIN topics ON messages.topic_id = topics.id "
            f"WHERE topics.type IN ({marks}) ORDER BY messages.timestamp, messages.id",
            types,
        )
        for topic, data in rows:
            if isinstance(data, bytes):
                yield RawMessage(str(topic), data, cdr=True)
            else:
                count("bad_record")
    except sqlite3.Error:
        count("bad_record")
    finally:
        database.close()


def _mcap_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    try:
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader
    except ImportError as error:
        raise MissingExtraError("MCAP files need: pip install 'spikingtac[formats]'") from error
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str, str]] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    name = schemas.get(record.schema_id, "")
                    channels[record.id] = (record.topic, name, record.message_encoding)
                elif isinstance(record, Message):
                    topic, name, encoding = channels.get(record.channel_id, ("", "", ""))
                    if name in types:
                        yield RawMessage(topic, record.data, cdr=encoding != "ros1")
        except (McapError, struct.error, ValueError, EOFError, OSError, RuntimeError):
            count("truncated")


def _ros1_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    try:
        from rosbags.rosbag1 import Reader, ReaderError
    except ImportError as error:
        raise MissingExtraError("ROS 1 bags need: pip install 'spikingtac[formats]'") from error
    try:
        with Reader(path) as reader:
            chosen = [item for item in reader.connections if item.msgtype in types]
            for connection, _, data in reader.messages(chosen):
                yield RawMessage(connection.topic, bytes(data), cdr=False)
    except (ReaderError, struct.error, ValueError, KeyError, AssertionError, OSError):
        count("truncated")
