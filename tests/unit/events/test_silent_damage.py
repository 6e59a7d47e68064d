"""Damage that once passed in silence: each is now mended, counted or refused."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from spikingtac.errors import DamageError, FormatError
from spikingtac.events import create_events, open_events
from spikingtac.types import EventPacket
from stand_ins.random_packets import random_packet

SIZE = (320, 320)
N = 20_000
SAMPLE = random_packet(3, N, SIZE, 60, 1_000)


def whole(path: Path, **options: Any) -> tuple[EventPacket, dict[str, int]]:
    source = open_events(path, **options)
    found = EventPacket.concatenate(list(source))
    return found, dict(source.losses)


def save(path: Path, **changes: np.ndarray) -> None:
    columns = {name: getattr(SAMPLE, name).copy() for name in "txyp"} | changes
    np.savez(path, **{"size": np.array(SIZE)} | columns)  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [(70_000, 4), (320, 65_537), (0, 4), (-3, 4), (65_536, 65_536)])
def test_impossible_sizes_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    save(tmp_path / "a.npz", size=np.array(size))
    with pytest.raises(FormatError, match="not possible"):
        open_events(tmp_path / "a.npz")
    save(tmp_path / "b.npz")
    with pytest.raises(FormatError, match="not possible"):
        open_events(tmp_path / "b.npz", size=size)


def test_a_false_count_in_an_aedat4_packet_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.aedat4"
    with create_events(path, SIZE) as writer:
        writer.write(SAMPLE)
    data = bytearray(path.read_bytes())
    place = data.index(b"EVTS", data.index(b"</dv>")) + 4
    count = data.index(struct.pack("<I", 4_096), place)
    for claimed in (0, 7, 1 << 31):
        data[count : count + 4] = struct.pack("<I", claimed)
        path.write_bytes(data)
        found, losses = whole(path)
        np.testing.assert_array_equal(found.t, SAMPLE.t)
        assert losses == {"bad_record": 1}


def test_a_wrong_length_in_an_aedat4_file_is_overcome(tmp_path: Path) -> None:
    path = tmp_path / "a.aedat4"
    with create_events(path, SIZE) as writer:
        writer.write(SAMPLE)
    data = bytearray(path.read_bytes())
    second = data.index(b"EVTS", data.index(b"EVTS", data.index(b"</dv>")) + 4) - 16
    data[second + 7] = 0x7F
    path.write_bytes(data)
    found, losses = whole(path)
    assert len(found) == N - 4_096
    assert losses["bad_record"] == 1


@pytest.mark.parametrize("kind", ["lz4", "zstd"])
def test_compressed_aedat4_is_read_and_a_damaged_packet_left_out(tmp_path: Path, kind: str) -> None:
    module = pytest.importorskip("lz4.frame" if kind == "lz4" else "zstandard")
    pack = module.compress if kind == "lz4" else module.ZstdCompressor(write_checksum=True).compress
    path = tmp_path / "a.aedat4"
    with create_events(path, SIZE) as writer:
        writer.write(SAMPLE)
    data = path.read_bytes()
    (head,) = struct.unpack_from("<I", data, 14)
    first = 18 + head
    packets, place = [], first
    while place < len(data):
        stream, length = struct.unpack_from("<iI", data, place)
        stored = pack(data[place + 8 : place + 8 + length])
        packets.append(struct.pack("<iI", stream, len(stored)) + stored)
        place += 8 + length
    out = _with_compression(data[:first], 1 if kind == "lz4" else 3)
    path.write_bytes(out + b"".join(packets))
    found, losses = whole(path)
    np.testing.assert_array_equal(found.t, SAMPLE.t)
    assert losses == {}
    packets[1] = packets[1][:40] + bytes(20) + packets[1][60:]
    path.write_bytes(out + b"".join(packets))
    found, losses = whole(path)
    assert len(found) in (N, N - 4_096)
    assert losses.get("bad_record", 0) >= int(len(found) < N)


def _with_compression(head: bytes, number: int) -> bytes:
    """Return the head of a file whose table names a compression."""
    (length,) = struct.unpack_from("<I", head, 14)
    body = head[18 : 18 + length]
    info = body[body.index(b"<dv") : body.rindex(b">") + 1]
    vtable = struct.pack("<HHHHH2x", 10, 12, 8, 0, 4)
    table = struct.pack("<iIi", 12, 8, number)
    new = struct.pack("<I4s", 20, b"IOHE") + vtable + table
    new += struct.pack("<I", len(info)) + info + b"\0"
    new += bytes(-len(new) % 4)
    return head[:14] + struct.pack("<I", len(new)) + new


def write_h5(path: Path, **columns: np.ndarray) -> None:
    with h5py.File(path, "w") as file:
        for name in "txyp":
            file[f"events/{name}"] = columns.get(name, getattr(SAMPLE, name))
        if "t_offset" in columns:
            file["t_offset"] = columns["t_offset"]


def test_hdf5_columns_of_unequal_length_are_counted(tmp_path: Path) -> None:
    write_h5(tmp_path / "a.h5", y=SAMPLE.y[:-5_000])
    found, losses = whole(tmp_path / "a.h5")
    assert len(found) == N - 5_000
    assert losses == {"truncated": 1}
    with pytest.raises(DamageError, match="truncated"):
        whole(tmp_path / "a.h5", strict=True)
