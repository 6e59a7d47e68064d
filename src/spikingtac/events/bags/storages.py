"""The storages of ROS bags, as raw messages of given types: sqlite3, MCAP, ROS 1.

Of sqlite3 only plain tables are read, nothing that the file would compute.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from spikingtac.errors import FormatError
from spikingtac.events.formats.limits import piece_limit_bytes

Count = Callable[[str], None]  # Counts one more of a kind of damage.


class RawMessage(NamedTuple):
    """A message as it was stored; ``cdr`` for ROS 2, else the ROS 1 serialisation."""

    topic: str
    data: bytes
    cdr: bool
    kind: str


TABLES = ("messages", "topics")
STORED = 0  # What ``table_xinfo`` says of a column that is stored; others are computed or hidden.


def database_messages(path: Path, types: tuple[str, ...], count: Count) -> Iterator[RawMessage]:
    """Yield the messages of the given types in the order of their recording.

    Raises:
        FormatError: The tables are views, or computed.
    """
    database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    # Texts stay bytes, since nothing says that those of a damaged file are UTF-8.
    database.text_factory = bytes
    try:
        database.execute("PRAGMA trusted_schema = OFF")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(piece_limit_bytes(), (1 << 31) - 1))
        _require_tables(database, path)
        marks = ",".join("?" * len(types))
        rows = database.execute(
            "SELECT topics.name, topics.type, messages.data FROM messages "
            "JOIN topics ON messages.topic_id = topics.id "
            f"WHERE topics.type IN ({marks}) ORDER BY messages.timestamp, messages.id",
            types,
        )
        for topic, kind, data in rows:
            if isinstance(data, bytes) and isinstance(topic, bytes):
                name, told = topic.decode("utf-8", "replace"), bytes(kind).decode("latin-1")
                yield RawMessage(name, data, cdr=True, kind=told)
            else:
                count("bad_record")
    except (sqlite3.Error, MemoryError, OverflowError):
        count("bad_record")
    finally:
        database.close()


def _require_tables(database: sqlite3.Connection, path: Path) -> None:
    for name in TABLES:
        kinds = database.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (name,))
        for kind, sql in kinds.fetchall():
            virtual = b"virtual" in bytes(sql or b"").lower().split()[:2]
            columns = database.execute(f"PRAGMA table_xinfo({name})").fetchall()
            if kind != b"table" or virtual or any(column[6] != STORED for column in columns):
                raise FormatError(
                    f"{str(path)!r}: {name!r} is no plain table but computed by the file (a view, "
                    "a virtual table or a generated column), which is not read; export the bag anew"
                )
