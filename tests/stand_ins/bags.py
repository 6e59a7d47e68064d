"""Bags as recorders write them, built byte by byte: sqlite3, MCAP, ROS 1."""

import bz2
import sqlite3
import struct
import zlib
from pathlib import Path

import numpy as np

KIND = "event_camera_msgs/msg/EventPacket"
ROS1_KIND = "event_camera_msgs/EventPacket"


def packet_words(t_us: int) -> bytes:
    """Return EVT3 words of one ON event at (1, 3)."""
    return np.array(
        [0x8000 | t_us >> 12 & 0xFFF, 0x6000 | t_us & 0xFFF, 3, 0x2801], "<u2"
    ).tobytes()


def cdr(
    sequence: int, encoding: bytes, events: bytes, base_ns: int = 0, ros1: bool = False
) -> bytes:
    """Return an event_camera_msgs/EventPacket in the serialisation of ROS 2, or of ROS 1."""
    if ros1:
        data = struct.pack("<IIII2s", 1, 1, 2, 2, b"ab") + struct.pack("<II", 240, 320)
        data += struct.pack("<QQ", sequence, base_ns) + _sized(encoding) + b"\0"
        return data + _sized(events)
    data = struct.pack("<IiII3sx", 0x100, 1, 2, 3, b"ab\0")
    data += struct.pack("<IIQQ", 240, 320, sequence, base_ns)
    data += struct.pack("<I", len(encoding) + 1) + encoding + b"\0\0"
    return data + bytes(-(len(data) - 4) % 4) + _sized(events)


def write_db3(path: Path, messages: list[bytes]) -> None:
    """Write a ROS 2 bag in sqlite3."""
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
        base.execute(
            "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        base.execute("INSERT INTO topics VALUES(1, '/events', ?)", (KIND,))
        stored = [(index, 1, index, data) for index, data in enumerate(messages)]
        base.executemany("INSERT INTO messages VALUES(?, ?, ?, ?)", stored)
    base.close()


def mcap_file(chunks: list[list[bytes]], kind: str) -> bytes:
    """Return an MCAP of one topic, its messages in the given chunks."""
    magic = b"\x89MCAP0\r\n"
    parts = [magic, _record(0x01, _text("ros2") + _text("hand"))]
    first = 0
    for chunk in chunks:
        parts.append(mcap_chunk(chunk, kind, first))
        first += len(chunk)
    parts += [_record(0x0F, bytes(4)), _record(0x02, bytes(20)), magic]
    return b"".join(parts)


def mcap_chunk(messages: list[bytes], kind: str, first: int) -> bytes:
    """Return a chunk with schema, channel and messages; ``first`` is its first sequence number."""
    records = _record(0x03, struct.pack("<H", 1) + _text(KIND) + _text("ros2idl") + bytes(4))
    records += _record(0x04, struct.pack("<HH", 1, 1) + _text("/events") + _text("cdr") + bytes(4))
    for index, data in enumerate(messages, first):
        records += _record(0x05, struct.pack("<HIQQ", 1, index, index, index) + data)
    stored = _packed(records, kind)
    content = struct.pack("<QQQI", 0, 0, len(records), zlib.crc32(records)) + _text(kind)
    return _record(0x06, content + struct.pack("<Q", len(stored)) + stored)


def ros1_bag(chunks: list[list[bytes]], kind: str) -> bytes:
    """Return a ROS 1 bag of one topic."""
    parts = [b"#ROSBAG V2.0\n", _ros1_record({"op": b"\x03", "index_pos": bytes(8)}, b" " * 64)]
    about = _ros1_fields({"topic": b"/events", "type": ROS1_KIND.encode()})
    number = struct.pack("<I", 0)
    connection = _ros1_record({"op": b"\x07", "conn": number, "topic": b"/events"}, about)
    for chunk in chunks:
        records = connection
        for data in chunk:
            records += _ros1_record({"op": b"\x02", "conn": number, "time": bytes(8)}, data)
        size = struct.pack("<I", len(records))
        fields = {"compression": kind.encode(), "op": b"\x05", "size": size}
        parts.append(_ros1_record(fields, _packed(records, kind)))
    return b"".join(parts)


def _ros1_record(fields: dict[str, bytes], data: bytes) -> bytes:
    return _sized(_ros1_fields(fields)) + _sized(data)


def _ros1_fields(fields: dict[str, bytes]) -> bytes:
    return b"".join(_sized(name.encode() + b"=" + value) for name, value in fields.items())


def _packed(data: bytes, kind: str) -> bytes:
    if kind == "lz4":
        import lz4.frame

        return lz4.frame.compress(data)
    if kind == "zstd":
        import zstandard

        return zstandard.ZstdCompressor().compress(data)
    return bz2.compress(data) if kind == "bz2" else data


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    return _sized(text.encode())


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data
