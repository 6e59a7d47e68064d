"""Damage that passed in silence, claims, links and bombs: mended, counted or refused."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from spikingtac.errors import DamageError, FormatError, RecordingError
from spikingtac.events import create_events, open_events
from spikingtac.events.formats import hdf5
from spikingtac.events.formats.array_file import load_arrays
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


@pytest.mark.parametrize("size", [(70_000, 4), (0, 4), (-3, 4), (65_536, 65_536)])
def test_impossible_sizes_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    save(tmp_path / "a.npz", size=np.array(size))
    with pytest.raises(FormatError, match="not possible"):
        open_events(tmp_path / "a.npz")
    save(tmp_path / "b.npz")
    with pytest.raises(FormatError, match="not possible"):
        open_events(tmp_path / "b.npz", size=size)


def test_false_counts_and_lengths_in_an_aedat4_file_are_overcome(tmp_path: Path) -> None:
    path = tmp_path / "a.aedat4"
    with create_events(path, SIZE) as writer:
        writer.write(SAMPLE)
    data = bytearray(path.read_bytes())
    place = data.index(b"EVTS", data.index(b"</dv>")) + 4
    second = data.index(b"EVTS", place) - 16
    count = data.index(struct.pack("<I", 4_096), place)
    for claimed in (0, 7, 1 << 31):
        data[count : count + 4] = struct.pack("<I", claimed)
        path.write_bytes(data)
        found, losses = whole(path)
        np.testing.assert_array_equal(found.t, SAMPLE.t)
        assert losses == {"bad_record": 1}
    data[second + 7] = 0x7F
    path.write_bytes(data)
    found, losses = whole(path)
    assert (len(found), losses) == (N - 4_096, {"bad_record": 2})


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


def begun_h5(path: Path, name: str = "x") -> Any:
    file = h5py.File(path, "w")
    for column in "xypt":
        if column != name:
            file[f"events/{column}"] = np.zeros(8, np.int64)
    return file


def test_external_storage_and_huge_chunks_are_refused(tmp_path: Path) -> None:
    for name, told, given in (
        ("a.h5", "other files", {"shape": (8,), "external": [("/etc/passwd", 0, 8)]}),
        ("b.h5", "128 MiB", {"shape": (1 << 30,), "chunks": (1 << 30,)}),
    ):
        with begun_h5(tmp_path / name) as file:
            file.create_dataset("events/x", dtype="u1", **given)
        with pytest.raises(FormatError, match=told):
            open_events(tmp_path / name)


@pytest.mark.parametrize("soft", [False, True])
def test_links_are_not_followed(tmp_path: Path, soft: bool) -> None:
    with h5py.File(tmp_path / "b.h5", "w") as other:
        other["x"] = np.zeros(8)
    with begun_h5(tmp_path / "a.h5") as file:
        file["away" if soft else "events/x"] = h5py.ExternalLink("b.h5", "/x")
        if soft:
            file["events/x"] = h5py.SoftLink("/away")
    with pytest.raises(FormatError, match="is a link, which is not followed"):
        open_events(tmp_path / "a.h5")


def test_the_size_comes_from_the_attributes_and_the_search_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for size, attributes in (
        ((64, 48), {"geometry": "64x48"}),
        ((32, 24), {"width": 32, "height": np.int32(24)}),
        ((30, 20), {"sensor_resolution": np.array([20, 30])}),
    ):
        with begun_h5(tmp_path / "a.h5") as file:
            file["events/x"] = np.zeros(8, np.int64)
            file["events"].attrs.update({**attributes, "note": np.zeros(3)})
        assert open_events(tmp_path / "a.h5").size == size
    monkeypatch.setattr(hdf5, "TIME_LIMIT_S", 1e-3)
    with pytest.raises(FormatError, match="no end of its attributes"):
        open_events(tmp_path / "a.h5")


MIB = 1 << 20


def archive(path: Path) -> Path:
    np.savez_compressed(path, a=np.arange(5), b=np.zeros((0, 2)), c=np.array("text"), d=np.eye(3).T)
    return path


def test_arrays_come_back(tmp_path: Path) -> None:
    found = load_arrays(archive(tmp_path / "a.npz"), "arrays")
    with np.load(tmp_path / "a.npz") as expected:
        assert set(found) == set(expected.files)
        for name in found:
            np.testing.assert_array_equal(found[name], expected[name])
            assert found[name].flags.writeable


@pytest.mark.parametrize("seed", range(20))
def test_damage_is_told_in_our_words(tmp_path: Path, seed: int) -> None:
    data = bytearray(archive(tmp_path / "a.npz").read_bytes())
    rng = np.random.default_rng(seed)
    for place in rng.integers(0, len(data), 1 + seed % 4):
        data[place] = rng.integers(0, 256)
    (tmp_path / "a.npz").write_bytes(data[: len(data) - seed % 7 * 20])
    sound = load_arrays(archive(tmp_path / "b.npz"), "arrays")
    try:
        found = load_arrays(tmp_path / "a.npz", "arrays")
    except RecordingError:
        return
    for name in found.keys() & sound.keys():
        np.testing.assert_array_equal(found[name], sound[name])


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", size=np.zeros(200 * MIB, np.uint8))
    with pytest.raises(RecordingError, match="128 MiB"):
        load_arrays(tmp_path / "a.npz", "arrays")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as file:
        head = "{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000,), }"
        length = len(head).to_bytes(2, "little")
        file.writestr("a.npy", b"\x93NUMPY\x01\x00" + length + head.encode())
    with pytest.raises(RecordingError, match="claims"):
        load_arrays(tmp_path / "b.npz", "arrays")
