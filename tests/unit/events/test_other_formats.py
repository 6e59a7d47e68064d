"""Files as others write them, damage that passed in silence, claims, links and bombs."""

import struct
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from spikingtac.errors import ConfigError, DamageError, FormatError, RecordingError
from spikingtac.events import open_events
from spikingtac.events.formats import hdf5
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.types import EventPacket
from stand_ins.bags import cdr, packet_words, write_db3
from stand_ins.random_packets import random_packet, rows, save_events

ROWS = [(10, 1, 2, 1), (20, 3, 4, 0), (20, 319, 100, 1)]


def test_a_table_with_bad_lines(tmp_path: Path) -> None:
    text = "t,x,y,p\n10,1,2,1\noops\n15,1\n20,3,4,0\n20,900,4,0\n# size\n20,319,100,1\nnan,1,1,1\n"
    (tmp_path / "a.csv").write_text(text)
    source = open_events(tmp_path / "a.csv", size=(320, 320))
    assert rows(*source) == ROWS
    assert dict(source.losses) == {"bad_record": 3, "out_of_range": 1}


def test_comments_that_fill_a_chunk_are_passed_over_in_silence(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    text = "t,x,y,p\n10,1,2,1\n" + f"# {'-' * 1_000}\n" * 2_500 + "20,3,4,0\n"
    (tmp_path / "a.csv").write_text(text)
    assert rows(*open_events(tmp_path / "a.csv", size=(320, 320))) == ROWS[:2]
    assert not recwarn.list


@pytest.mark.parametrize("bad", [(0, np.nan), (2, np.inf), (-1, np.nan)])
def test_rows_without_a_number_are_dropped_from_arrays(
    tmp_path: Path, bad: tuple[int, float]
) -> None:
    """A time that was none became time zero, and moved its neighbours."""
    t = np.arange(9) / 1e6 + 1.25
    t[bad[0]] = bad[1]
    columns = {"t": t, "x": np.arange(9), "y": np.arange(9) % 2, "p": np.arange(9) % 2}
    np.savez(tmp_path / "a.npz", **columns)
    np.save(tmp_path / "a.npy", np.column_stack(list(columns.values())))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in columns.items():
            file[name] = column
    for name in ("a.npz", "a.npy", "a.h5"):
        source = open_events(tmp_path / name, size=(9, 9))
        found = [(row[0], row[1]) for row in rows(*source)]
        assert found == [(1_250_000 + k, k) for k in range(9) if k != bad[0] % 9]
        assert dict(source.losses) == {"bad_record": 1}


def test_hdf5_that_claims_too_much_does_not_hang(tmp_path: Path) -> None:
    kind = np.dtype([("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", "i8")])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        table = file.create_dataset("CD/events", (1 << 50,), kind, chunks=(1_024,))
        table[:3] = np.zeros(3, kind)
    source = open_events(tmp_path / "a.h5", size=(4, 4))
    assert rows(*source) == []
    assert dict(source.losses) == {"bad_record": 1}


def test_dat_files(tmp_path: Path) -> None:
    period = 1 << 32
    times = [period - 5, period + 3, period + 4]
    body = b"".join(
        struct.pack("<II", t % period, p << 28 | y << 14 | x)
        for t, (_, x, y, p) in zip(times, ROWS, strict=True)
    )
    head = b"% Data file containing CD events.\n% Version 2\n% Height 240\n% Width 320\n"
    (tmp_path / "a.dat").write_bytes(head + b"\x0c\x08" + body + bytes(4_096) + b"\x01")
    source = open_events(tmp_path / "a.dat")
    assert rows(*source) == [(t, *row[1:]) for t, row in zip(times, ROWS, strict=True)]
    assert (source.size, dict(source.losses)) == ((320, 240), {"truncated": 1, "garbage": 1})
    body = b"".join(struct.pack("<II", t, p << 17 | y << 9 | x) for t, x, y, p in ROWS)
    for head in (b"", b"% Version 1\n"):
        (tmp_path / "b.dat").write_bytes(head + b"\0\x08" + body)
        assert rows(*open_events(tmp_path / "b.dat")) == ROWS


MESSAGES = [
    cdr(7, b"evt3", packet_words(5)),
    cdr(8, b"evt3", struct.pack("<H", 0x2802)),
    cdr(11, b"evt3", struct.pack("<HHH", 0x6006, 0x2003, 0xA001)),
]
DECODED = [(5, 1, 3, 1), (5, 2, 3, 1), (6, 3, 3, 0)]


def test_a_ros2_bag_keeps_state_and_counts_missing_messages(tmp_path: Path) -> None:
    write_db3(tmp_path / "a.db3", [*MESSAGES, MESSAGES[0][:30]])
    source = open_events(tmp_path / "a.db3")
    assert rows(*source) == DECODED
    assert source.size == (320, 240)
    assert dict(source.losses) == {"gap": 1, "trigger": 1, "bad_record": 1}
    assert list(source.triggers) == [(6, 0, True)]


def test_mono_packets_are_read(tmp_path: Path) -> None:
    events = np.array([5_000 | 9 << 32 | 4 << 48 | 1 << 63, 8_999 | 1 << 32 | 2 << 48], "<u8")
    data = [cdr(1, b"mono", events.tobytes(), base) for base in (1_000_000, 2_000_000)]
    write_db3(tmp_path / "a.db3", data)
    expected = [(5, 9, 4, 1), (8, 1, 2, 0), (1_005, 9, 4, 1), (1_008, 1, 2, 0)]
    assert rows(*open_events(tmp_path / "a.db3")) == expected


def test_a_bag_folder_opens_its_storage(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    for number in (10, 9):  # in the order of their numbers, not of their letters
        write_db3(tmp_path / f"bag_{number}.db3", [cdr(number, b"evt3", packet_words(number))])
    assert rows(*open_events(tmp_path)) == [(9, 1, 3, 1), (10, 1, 3, 1)]


def test_es_counts_rows_from_the_bottom(tmp_path: Path) -> None:
    head = b"Event Stream\x02\x00\x00\x01" + struct.pack("<HH", 320, 240)
    (tmp_path / "a.es").write_bytes(head + b"\xff\xfe" + struct.pack("<BHH", 3 << 1 | 1, 7, 0))
    assert rows(*open_events(tmp_path / "a.es")) == [(130, 7, 239, 1)]


def test_aedat4_reads_as_the_library_does(tmp_path: Path) -> None:
    aedat = pytest.importorskip("aedat", reason="the oracle comes with the extra [formats]")
    packet = random_packet(0, 9_000, (320, 240), 5)
    save_events(tmp_path / "a.aedat4", packet)
    decoder = aedat.Decoder(str(tmp_path / "a.aedat4"))
    assert decoder.id_to_stream() == {0: {"type": "events", "width": 320, "height": 240}}
    theirs = np.concatenate([item["events"] for item in decoder])
    for column in "txy":
        np.testing.assert_array_equal(theirs[column], getattr(packet, column))
    np.testing.assert_array_equal(theirs["on"], packet.p)


@pytest.mark.parametrize("text", ["1e17,1,2,1\n2.5,3,4,0\n", "-1e300 1 2 1\n9e15 3 4 0\n"])
def test_absurd_times_are_no_crash(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = [row[0] for row in rows(*open_events(tmp_path / "a.csv"))]
    assert found == sorted(found)
    assert found


def board_rows(t_us: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(0)
    count = len(t_us)
    x, y, on = rng.integers(0, 320, count), rng.integers(0, 320, count), rng.integers(0, 2, count)
    seconds, rest = np.divmod(t_us, 1_000_000)
    return np.column_stack([on, seconds % (1 << 16), rest // 1000, rest % 1000, x, y]).astype("<u2")


def test_an_openmv_recording_is_read_and_its_pickle_is_not(tmp_path: Path) -> None:
    t_us = np.sort(np.random.default_rng(1).integers(0, 3_000_000, 100_000))
    events = board_rows(t_us)
    events[500:510, 0] = 16  # an external trigger's type, as the firmware numbers it
    np.savez_compressed(tmp_path / "a.npz", events=events, metadata=np.array({"mode": 1}, object))
    source = open_events(tmp_path / "a.npz")
    kept = events[:, 0] < 2
    columns = t_us[kept], *events[kept][:, [4, 5]].T, events[kept, 0] == 1
    assert rows(*source) == list(zip(*(column.tolist() for column in columns), strict=True))
    assert (source.format, source.size) == ("OpenMV NPZ", (320, 320))
    assert dict(source.losses) == {"vendor_word": 10}
    t_us = (1 << 16) * 1_000_000 + np.arange(-500, 500, dtype=np.int64) * 100
    np.savez(tmp_path / "b.npz", events=board_rows(t_us))  # the seconds wrap
    assert [row[0] for row in rows(*open_events(tmp_path / "b.npz"))] == t_us.tolist()


DATES = [("t", "M8[us]"), ("x", "u2"), ("y", "u2"), ("p", "?")]
COMPLEX = [("t", "i8"), ("x", "c8"), ("y", "u2"), ("p", "?")]
OTHERS = [np.zeros((3, 9, 9)), np.zeros(9, DATES), np.zeros((9, 1), COMPLEX), np.array([{}])]


@pytest.mark.parametrize("array", OTHERS)
def test_what_is_no_array_of_events_is_refused(tmp_path: Path, array: np.ndarray) -> None:
    np.savez(tmp_path / "a.npz", events=array)
    with pytest.raises(FormatError, match=r"no columns of time|Python objects"):
        open_events(tmp_path / "a.npz")


SIZE = (320, 320)
N = 20_000
SAMPLE = random_packet(3, N, SIZE, 60, 1_000)


def whole(path: Path, **options: Any) -> tuple[EventPacket, dict[str, int]]:
    source = open_events(path, **options)
    return EventPacket.concatenate(list(source)), dict(source.losses)


def save(path: Path, size: tuple[int, int] = SIZE) -> None:
    np.savez(path, size=np.array(size), **{name: getattr(SAMPLE, name) for name in "txyp"})


@pytest.mark.parametrize("size", [(70_000, 4), (0, 4), (-3, 4), (65_536, 65_536)])
def test_impossible_sizes_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    save(tmp_path / "a.npz", size)
    with pytest.raises(FormatError, match="not possible"):
        open_events(tmp_path / "a.npz")
    save(tmp_path / "b.npz")
    with pytest.raises(ConfigError, match=r"not possible .* --size WxH"):
        open_events(tmp_path / "b.npz", size=size)


def test_false_counts_and_lengths_in_an_aedat4_file_are_overcome(tmp_path: Path) -> None:
    path = save_events(tmp_path / "a.aedat4", SAMPLE)
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
    path = save_events(tmp_path / "a.aedat4", SAMPLE)
    data = path.read_bytes()
    first = 18 + struct.unpack_from("<I", data, 14)[0]
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
    info = head[head.index(b"<dv") : head.rindex(b">") + 1]
    vtable = struct.pack("<HHHHH2x", 10, 12, 8, 0, 4)
    new = struct.pack("<I4s", 20, b"IOHE") + vtable + struct.pack("<iIi", 12, 8, number)
    new += struct.pack("<I", len(info)) + info + b"\0"
    new += bytes(-len(new) % 4)
    return head[:14] + struct.pack("<I", len(new)) + new


def test_hdf5_columns_of_unequal_length_are_counted(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in "txyp":
            file[f"events/{name}"] = getattr(SAMPLE, name)[: -5_000 if name == "y" else None]
    found, losses = whole(tmp_path / "a.h5")
    assert len(found) == N - 5_000
    assert losses == {"truncated": 1}
    with pytest.raises(DamageError, match="truncated"):
        whole(tmp_path / "a.h5", strict=True)


def begun_h5(path: Path) -> Any:
    """Return a file that lacks columns."""
    file = h5py.File(path, "w")
    for column in "ypt":
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
