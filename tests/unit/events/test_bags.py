"""Damaged and hostile bags: what is sound is read, the rest is counted or refused."""

import sqlite3
import struct
from pathlib import Path
from typing import Any

import pytest

from spikingtac.errors import FormatError, RecordingError
from spikingtac.events import open_events
from stand_ins.bags import cdr, mcap_chunk, mcap_file, packet_words, ros1_bag, write_db3
from stand_ins.random_packets import rows

PER_CHUNK, CHUNKS = 5, 12


def opened(path: Path, data: bytes, **options: Any) -> Any:
    path.write_bytes(data)
    return open_events(path, **options)


def places_of_chunks(data: bytes) -> list[int]:
    return [at for at in range(len(data)) if data.startswith(b"\x04\x00\x00\x00op=\x05", at)]


def expected(missing: int | None = None) -> list[tuple[int, int, int, int]]:
    return [
        (5 * index, 1, 3, 1)
        for index in range(PER_CHUNK * CHUNKS)
        if missing is None or index // PER_CHUNK != missing
    ]


def messages(ros1: bool = False) -> list[bytes]:
    numbers = range(PER_CHUNK * CHUNKS)
    return [cdr(index, b"evt3", packet_words(5 * index), ros1=ros1) for index in numbers]


def chunked(ros1: bool = False) -> list[list[bytes]]:
    given = messages(ros1)
    return [given[first : first + PER_CHUNK] for first in range(0, len(given), PER_CHUNK)]


@pytest.mark.parametrize("kind", ["", "lz4", "zstd"])
def test_a_flipped_bit_in_an_mcap_costs_one_chunk(tmp_path: Path, kind: str) -> None:
    data = bytearray(mcap_file(chunked(), kind))
    chunk = mcap_chunk(chunked()[4], kind, first=4 * PER_CHUNK)
    place = bytes(data).index(chunk) + len(chunk) - 9
    data[place] ^= 0x10
    source = opened(tmp_path / "a.mcap", data)
    assert rows(*source) == expected(missing=4)
    assert dict(source.losses) == {"bad_record": 1, "gap": 1}


def test_a_cut_mcap_gives_what_comes_before_the_cut(tmp_path: Path) -> None:
    data = mcap_file(chunked(), "zstd")
    source = opened(tmp_path / "a.mcap", data[: len(data) // 2])
    found = rows(*source)
    assert found == expected()[: len(found)]
    assert 10 < len(found) < len(expected())
    assert source.losses["truncated"] == 1


@pytest.mark.parametrize("ros1", [False, True])
def test_a_wrong_length_is_overcome(tmp_path: Path, ros1: bool) -> None:
    data = bytearray((ros1_bag if ros1 else mcap_file)(chunked(ros1), "lz4"))
    chunk = mcap_chunk(chunked()[4], "lz4", first=4 * PER_CHUNK)
    data[places_of_chunks(data)[4] - 23 if ros1 else data.index(chunk) + 5] ^= 0x40
    source = opened(tmp_path / "a.bag", data)
    assert rows(*source) == expected(missing=4)
    assert source.losses["bad_record"] == 1


def test_messages_that_are_compressed_one_by_one(tmp_path: Path) -> None:
    pack = pytest.importorskip("zstandard").compress
    write_db3(tmp_path / "a.db3", [pack(message) for message in messages()])
    assert rows(*open_events(tmp_path / "a.db3")) == expected()


@pytest.mark.parametrize("kind", ["lz4", "zstd"])
def test_a_bomb_in_an_mcap_is_refused(tmp_path: Path, kind: str) -> None:
    module = pytest.importorskip("lz4.frame" if kind == "lz4" else "zstandard")
    pack = module.compress if kind == "lz4" else module.ZstdCompressor().compress
    size = 200 << 20
    stored = pack(bytes(size))
    head = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(kind)) + kind.encode()
    content = head + struct.pack("<Q", len(stored)) + stored
    bomb = struct.pack("<BQ", 6, len(content)) + content
    whole = mcap_file(chunked(), kind)
    place = whole.index(mcap_chunk(chunked()[4], kind, first=4 * PER_CHUNK))
    with pytest.raises(FormatError, match="128 MiB"):
        rows(*opened(tmp_path / "a.mcap", whole[:place] + bomb + whole[place:]))


@pytest.mark.parametrize("kind", ["none", "lz4", "bz2"])
def test_ros1_bags_lose_one_chunk(tmp_path: Path, kind: str) -> None:
    whole = ros1_bag(chunked(ros1=True), kind)
    assert rows(*opened(tmp_path / "a.bag", whole, strict=True)) == expected()
    opened(tmp_path / "b.bag", whole)
    with pytest.raises(RecordingError, match=r"a\.bag, .*b\.bag: give one of these"):
        open_events(tmp_path)
    data, place = bytearray(whole), places_of_chunks(whole)[4]
    data[place + 60] ^= 0xFF
    data[place + 70] ^= 0xFF
    source = opened(tmp_path / "a.bag", data)
    found = rows(*source)
    assert len(found) >= len(expected(missing=4)) - 1
    assert found[-PER_CHUNK:] == expected()[-PER_CHUNK:]
    assert source.losses["bad_record"] + source.losses["gap"] >= 1


@pytest.mark.parametrize("kind", ["none", "lz4"])
def test_a_cut_chunk_of_a_ros1_bag_gives_what_can_be_read_of_it(tmp_path: Path, kind: str) -> None:
    whole = ros1_bag([messages(ros1=True)], kind)
    cut = whole[: len(whole) - len(whole) // 8]
    if kind == "none":
        source = opened(tmp_path / "a.bag", cut)
        found = rows(*source)
        assert found == expected()[: len(found)]
        assert (len(found) > 40, source.losses["truncated"]) == (True, 1)
        return
    with pytest.raises(FormatError, match="is cut before its first readable message of events"):
        opened(tmp_path / "a.bag", cut)


def test_names_out_of_utf8_and_another_camera_are_no_damage(tmp_path: Path) -> None:
    write_db3(tmp_path / "a.db3", messages())
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.executescript(
            "UPDATE topics SET name = CAST(X'FF2F65' AS TEXT);"
            "INSERT INTO topics SELECT 2, '/other', type FROM topics;"
            "INSERT INTO messages SELECT id, 2, timestamp, data FROM messages"
        )
    base.close()
    assert rows(*open_events(tmp_path / "a.db3", sensor=1, strict=True)) == expected()
    (tmp_path / "a.db3-wal").write_bytes(b"messages")
    source = open_events(tmp_path / "a.db3", sensor=1)
    assert (rows(*source), source.losses) == (expected(), {"truncated": 1, "other_data": 60})
    data = (tmp_path / "a.db3").read_bytes()
    cut = opened(tmp_path / "a.db3", data[: len(data) // 4 * 3], sensor=1)
    assert rows(*cut)[:40] == expected()[:40]
    (tmp_path / "a.db3").write_bytes(data[:5_000])
    with pytest.raises(FormatError, match="is cut before its first readable message of events"):
        open_events(tmp_path / "a.db3")


@pytest.mark.parametrize(
    "statements",
    [
        ["ALTER TABLE messages RENAME TO m", "CREATE VIEW messages AS SELECT * FROM m"],
        [
            "DROP TABLE messages",
            "CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(900000000)))",
            "INSERT INTO messages(id, topic_id, timestamp) VALUES(1, 1, 1)",
        ],
    ],
)
def test_computed_tables_are_refused(tmp_path: Path, statements: list[str]) -> None:
    write_db3(tmp_path / "a.db3", messages())
    with sqlite3.connect(tmp_path / "a.db3") as base:
        for statement in statements:
            base.execute(statement)
    base.close()
    with pytest.raises(FormatError, match="no plain table"):
        open_events(tmp_path / "a.db3")
