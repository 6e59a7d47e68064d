"""ROS bags of events: ROS 1, ROS 2 sqlite3 and MCAP, whole or split into several files.

Messages are read by their published layout, so bags without type definitions (or with ones in
ros2idl) are read as well. Source: ``event_camera_msgs/EventPacket`` (words of a camera), and
``dvs_msgs/EventArray`` and ``prophesee_event_msgs/EventArray``, which share one layout (public). Of
sqlite3 only plain tables are read, nothing that the file would compute.
"""

import sqlite3
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.bags import Mcap, RawMessage, Ros1, messages_in
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows, chosen_sensor
from spikingtac.events.formats.pieces import PIECE_LIMIT_BYTES, ZSTD, Count, decompressed
from spikingtac.types import LossCounters

# Encoding ``mono``: from the lowest bit, 32 bits of time (ns after the base), 16 x, 15 y, 1 p.
MONO_EVENT = np.dtype("<u8")

PACKETS = ("event_camera_msgs/msg/EventPacket", "event_camera_msgs/EventPacket")
ARRAYS = tuple(
    f"{package}{kind}/EventArray"
    for package in ("dvs_msgs", "prophesee_event_msgs")
    for kind in ("", "/msg")
)

# How the events of a message are written; ``array`` stands for the messages of single events.
ENCODINGS = ("evt3", "evt2", "evt21", "mono", "array")

NS_PER_US = 1_000
STORED = 0  # What ``table_xinfo`` says of a column that is stored; others are computed or hidden.

# Bytes of a message that are decoded at once: a word may stand for 32 events.
PIECE_BYTES = 1 << 18

# Messages among which the cameras of a bag are found: each has sent one by then.
FIRST_MESSAGES = 256

# Fields of an event in an array, its bytes and the places of its fields: ROS 2 aligns them.
ARRAY_FIELDS = (("x", "u2"), ("y", "u2"), ("s", "u4"), ("ns", "u4"), ("p", "u1"))
PACKED, ALIGNED = (13, (0, 2, 4, 8, 12)), (16, (0, 2, 6, 10, 14))


class _Packet(NamedTuple):
    """A message of events; ``order`` is that of its bytes, ``cdr`` whether fields are aligned."""

    size: tuple[int, int]
    sequence: int
    base_ns: int
    encoding: str
    events: bytes
    order: str
    cdr: bool


class RosSource(FileSource):
    """Events of one camera in a bag; EVT3 words keep their state from message to message.

    Sequence numbers that are left out count as ``gap``; messages that do not parse as
    ``bad_record``, those of other encodings as ``unknown_message``, those of other cameras as
    ``other_data``.

    Args:
        path: A bag, or its first file.
        options: As of a file.
        others: The files that follow, in order.

    Raises:
        FormatError: The bag holds no events, or only encodings that are not read.
        ConfigError: It holds several cameras, and none was chosen.
        MissingExtraError: The storage needs a library that is not installed.
    """

    def __init__(self, path: Path, options: ReadOptions, others: tuple[Path, ...] = ()) -> None:
        self._paths, self.losses = (path, *others), LossCounters()
        topics = self._topics()
        if not topics:
            raise FormatError(
                f"{str(path)!r} is cut before its first readable message of events; copy it "
                "again from where it was recorded"
                if self.losses["truncated"]
                else f"{str(path)!r} holds no readable messages of events (valid: {PACKETS[1]}, "
                f"{', '.join(ARRAYS[::2])}); record the camera's packet topic, not a rendered image"
            )
        self._topic = list(topics)[chosen_sensor(list(topics), options.sensor, path)]
        self._first = first = topics[self._topic]
        if first.encoding not in ENCODINGS:
            raise FormatError(
                f"{str(path)!r}: events are encoded as {first.encoding!r}, which is not read "
                f"(valid: {', '.join(ENCODINGS[:-1])}); set the driver to one of these, or convert "
                "the bag with event_camera_tools"
            )
        self.format = f"ROS bag ({first.encoding})"
        self.checked = first.encoding not in ("mono", "array")  # decoders of words check
        self._named_size = first.size if min(first.size) > 0 else None
        super().__init__(path, options)

    def _topics(self) -> dict[str, _Packet]:
        """Return the cameras' topics in the order of their names, with a first packet of each."""
        found: dict[str, _Packet] = {}
        for topic, packet in islice(self._packets(None), FIRST_MESSAGES):
            found.setdefault(topic, packet)
        return dict(sorted(found.items()))

    def _columns(self) -> Iterator[Rows]:
        from spikingtac.events.evt.words import WordStream

        encoding, stream, start_ns, following = self._first.encoding, None, None, None
        if self.checked:
            stream = WordStream(encoding, self.size, self.losses, self.triggers)
        for _, packet in self._packets(self._topic):
            if packet.encoding != encoding:
                self.losses.add("unknown_message")
                continue
            self.losses.add("gap", int(following is not None and packet.sequence > following))
            following = packet.sequence + 1 if packet.sequence >= 0 else None
            if stream is not None:
                for first in range(0, max(len(packet.events), 1), PIECE_BYTES):
                    final = first + PIECE_BYTES >= len(packet.events)
                    yield stream.feed(packet.events[first : first + PIECE_BYTES], final)
            elif encoding == "array":
                yield _array_events(packet)
            else:
                start_ns = packet.base_ns if start_ns is None else start_ns
                yield _mono_events(packet, start_ns)

    def _packets(self, topic: str | None) -> Iterator[tuple[str, _Packet]]:
        for path in self._paths:
            log = Path(f"{path}-wal")  # what a recorder that was ended did not put into the file
            self.losses.add("truncated", int(log.is_file() and log.stat().st_size > 0))
            for message in messages_of(path, (*PACKETS, *ARRAYS), self.losses.add):
                if topic is not None and message.topic != topic:
                    self.losses.add("other_data")
                    continue
                try:
                    yield message.topic, _parsed(message)
                except (struct.error, UnicodeDecodeError, IndexError, ValueError):
                    self.losses.add("bad_record")


def _parsed(message: RawMessage) -> _Packet:
    data, cdr = message.data, message.cdr
    if cdr and data.startswith(ZSTD):  # no encapsulation begins like that
        data = decompressed(data, "zstd", "a message")
    order = "<" if not cdr or data[1] & 1 else ">"
    origin = at = 4 if cdr else 0

    def block(length: int) -> bytes:
        nonlocal at
        at += length
        if at > len(data):
            raise ValueError("the message ends early")
        return data[at - length : at]

    def number(kind: str) -> int:
        nonlocal at
        length = struct.calcsize(kind)
        at += -(at - origin) % length if cdr else 0  # CDR aligns fields, ROS 1 does not
        return struct.unpack(order + kind, block(length))[0]

    for _ in range(2 if cdr else 3):  # the time; in ROS 1 a sequence number before it
        number("I")
    block(number("I"))  # the frame's name
    height, width = number("I"), number("I")
    if message.kind in ARRAYS:
        count, size = number("I"), (ALIGNED if cdr else PACKED)[0]
        length = max(size * count - (size - PACKED[0]), 0)  # no padding after the last one
        return _Packet((width, height), -1, 0, "array", block(length), order, cdr)
    sequence, base_ns = number("Q"), number("Q")
    encoding = block(number("I")).rstrip(b"\0").decode("ascii")
    number("B")  # byte order of the sender; the encodings are little-endian
    return _Packet((width, height), sequence, base_ns, encoding, block(number("I")), order, cdr)


def _mono_events(packet: _Packet, start_ns: int) -> Rows:
    """Return the columns of a packet of the encoding ``mono``: one word an event."""
    usable = len(packet.events) // MONO_EVENT.itemsize * MONO_EVENT.itemsize
    words = np.frombuffer(packet.events[:usable], MONO_EVENT)
    offset_us, rest_ns = divmod(packet.base_ns - start_ns, NS_PER_US)
    t = ((words & np.uint64(0xFFFFFFFF)).astype(np.int64) + rest_ns) // NS_PER_US + offset_us
    high = (words >> np.uint64(32)).astype(np.int64)
    return high & 0xFFFF, (high >> 16) & 0x7FFF, high >> 31 != 0, t


def _array_events(packet: _Packet) -> Rows:
    """Return the columns of a message of single events: x, y, seconds, nanoseconds, polarity."""
    length, offsets = ALIGNED if packet.cdr else PACKED
    data = packet.events
    if packet.cdr:
        # Each field is aligned, not each event: x and y of all but the first lie two bytes earlier.
        data = data[:4] + bytes(2) + data[4:]
        data += bytes(-len(data) % length)
    form: Any = {
        "names": [name for name, _ in ARRAY_FIELDS],
        "formats": [packet.order + kind for _, kind in ARRAY_FIELDS],
        "offsets": offsets,
        "itemsize": length,
    }
    events = np.frombuffer(data if len(packet.events) else b"", np.dtype(form))
    t = events["s"].astype(np.int64) * 1_000_000 + events["ns"].astype(np.int64) // NS_PER_US
    return events["x"], events["y"], events["p"] != 0, t


def messages_of(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: The file is no bag, or claims more than an input may.
        MissingExtraError: A chunk's compression needs a library that is not installed.
    """
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"SQLite"):
        return _database_messages(path, types, count)
    for bag in (Mcap, Ros1):
        if start.startswith(bag.MAGIC):
            return messages_in(bag(path), path, types, count)
    raise FormatError(
        f"{str(path)!r} begins like no bag (valid: ROS 2 sqlite3 .db3, .mcap, ROS 1 .bag)"
    )


def _database_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    # Texts stay bytes, since nothing says that those of a damaged file are UTF-8.
    database.text_factory = bytes
    try:
        # Without the second one, a file that was cut is refused as a whole.
        database.executescript("PRAGMA trusted_schema = OFF; PRAGMA writable_schema = ON")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, PIECE_LIMIT_BYTES)
        _require_tables(database, path)
        for topic, kind, data in database.execute(
            "SELECT topics.name, topics.type, messages.data FROM messages "
            "JOIN topics ON messages.topic_id = topics.id "
            f"WHERE topics.type IN ({','.join('?' * len(types))}) "
            "ORDER BY messages.rowid",
            types,
        ):
            if isinstance(data, bytes) and isinstance(topic, bytes):
                name, told = topic.decode("utf-8", "replace"), bytes(kind).decode("latin-1")
                yield RawMessage(name, data, cdr=True, kind=told)
            else:
                count("bad_record")
    except (sqlite3.Error, MemoryError, OverflowError):  # nothing behind the damage can be read
        count("truncated")
    finally:
        database.close()


def _require_tables(database: sqlite3.Connection, path: Path) -> None:
    for name in ("messages", "topics"):
        kinds = database.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (name,))
        for kind, sql in kinds.fetchall():
            virtual = b"virtual" in bytes(sql or b"").lower().split()[:2]
            columns = database.execute(f"PRAGMA table_xinfo({name})").fetchall()
            if kind != b"table" or virtual or any(column[6] != STORED for column in columns):
                raise FormatError(
                    f"{str(path)!r}: {name!r} is no plain table but computed by the file (a view, "
                    "a virtual table or a generated column), which is not read; export the bag anew"
                )
