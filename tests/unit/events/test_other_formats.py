"""Tables, archives and bags as others write them."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest

from spikingtac.errors import FormatError
from spikingtac.events import create_events, open_events
from stand_ins.bags import cdr, rows, write_db3
from stand_ins.random_packets import random_packet

ROWS = [(10, 1, 2, 1), (20, 3, 4, 0), (20, 319, 100, 1)]


def test_a_table_with_bad_lines(tmp_path: Path) -> None:
    text = "t,x,y,p\n10,1,2,1\noops\n15,1\n20,3,4,0\n20,900,4,0\n# size\n20,319,100,1\nnan,1,1,1\n"
    (tmp_path / "a.csv").write_text(text)
    source = open_events(tmp_path / "a.csv", size=(320, 320))
    assert rows(source) == ROWS
    assert dict(source.losses) == {"bad_record": 3, "out_of_range": 1}


def test_hdf5_that_claims_too_much_does_not_hang(tmp_path: Path) -> None:
    kind = np.dtype([("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", "i8")])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        table = file.create_dataset("CD/events", (1 << 50,), kind, chunks=(1_024,))
        table[:3] = np.zeros(3, kind)
    source = open_events(tmp_path / "a.h5", size=(4, 4))
    assert rows(source) == []
    assert dict(source.losses) == {"bad_record": 1}


def test_dat_files(tmp_path: Path) -> None:
    period = 1 << 32
    times = [period - 5, period + 3, period + 4]
    body = b"".join(
        struct.pack("<II", t % period, p << 28 | y << 14 | x)
        for t, (_, x, y, p) in zip(times, ROWS, strict=True)
    )
    head = b"% Data file containing CD events.\n% Version 2\n% Height 240\n% Width 320\n"
    (tmp_path / "a.dat").write_bytes(head + b"\x0c\x08" + body + b"\x01")
    source = open_events(tmp_path / "a.dat")
    assert [row[0] for row in rows(source)] == times
    assert [row[1:] for row in rows(source)] == [row[1:] for row in ROWS]
    assert (source.size, dict(source.losses)) == ((320, 240), {"truncated": 1})


def words(*values: int) -> bytes:
    return np.array(values, "<u2").tobytes()


MESSAGES = [
    cdr(7, b"evt3", words(0x8000, 0x6005, 3, 0x2801)),
    cdr(8, b"evt3", words(0x2802)),
    cdr(11, b"evt3", words(0x6006, 0x2003, 0xA001)),
]
DECODED = [(5, 1, 3, 1), (5, 2, 3, 1), (6, 3, 3, 0)]


def test_a_ros2_bag_keeps_state_and_counts_missing_messages(tmp_path: Path) -> None:
    write_db3(tmp_path / "a.db3", [*MESSAGES, MESSAGES[0][:30]])
    source = open_events(tmp_path / "a.db3")
    assert rows(source) == DECODED
    assert source.size == (320, 240)
    assert dict(source.losses) == {"gap": 1, "trigger": 1, "bad_record": 1}
    assert list(source.triggers) == [(6, 0, True)]


def test_mono_packets_are_read(tmp_path: Path) -> None:
    events = np.array([5_000 | 9 << 32 | 4 << 48 | 1 << 63, 8_999 | 1 << 32 | 2 << 48], "<u8")
    data = [cdr(1, b"mono", events.tobytes(), base) for base in (1_000_000, 2_000_000)]
    write_db3(tmp_path / "a.db3", data)
    expected = [(5, 9, 4, 1), (8, 1, 2, 0), (1_005, 9, 4, 1), (1_008, 1, 2, 0)]
    assert rows(open_events(tmp_path / "a.db3")) == expected


def test_a_bag_folder_opens_its_storage(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    for number in (10, 9):  # in the order of their numbers, not of their letters
        words_at = words(0x8000, 0x6000 | number, 3, 0x2801)
        write_db3(tmp_path / f"bag_{number}.db3", [cdr(number, b"evt3", words_at)])
    assert rows(open_events(tmp_path)) == [(9, 1, 3, 1), (10, 1, 3, 1)]


def test_es_counts_rows_from_the_bottom(tmp_path: Path) -> None:
    head = b"Event Stream\x02\x00\x00\x01" + struct.pack("<HH", 320, 240)
    (tmp_path / "a.es").write_bytes(head + b"\xff\xfe" + struct.pack("<BHH", 3 << 1 | 1, 7, 0))
    assert rows(open_events(tmp_path / "a.es")) == [(130, 7, 239, 1)]


def test_aedat4_reads_as_the_library_does(tmp_path: Path) -> None:
    aedat = pytest.importorskip("aedat", reason="the oracle comes with the extra [formats]")
    packet = random_packet(0, 9_000, (320, 240), 5)
    with create_events(tmp_path / "a.aedat4", (320, 240)) as writer:
        writer.write(packet)
    decoder = aedat.Decoder(str(tmp_path / "a.aedat4"))
    assert decoder.id_to_stream() == {0: {"type": "events", "width": 320, "height": 240}}
    theirs = np.concatenate([item["events"] for item in decoder])
    for column in "txy":
        np.testing.assert_array_equal(theirs[column], getattr(packet, column))
    np.testing.assert_array_equal(theirs["on"], packet.p)


@pytest.mark.parametrize("text", ["1e17,1,2,1\n2.5,3,4,0\n", "-1e300 1 2 1\n9e15 3 4 0\n"])
def test_absurd_times_are_no_crash(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = [row[0] for row in rows(open_events(tmp_path / "a.csv"))]
    assert found == sorted(found)
    assert found
    times = np.array([1e300, np.nan, -np.inf, 5.0])
    column = np.zeros(4, np.uint16)
    np.savez(tmp_path / "a.npz", t=times, x=column, y=column, p=column, size=[4, 4])
    found = [row[0] for row in rows(open_events(tmp_path / "a.npz"))]
    assert found == sorted(found)


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
    np.savez_compressed(
        tmp_path / "a.npz",
        events=events,
        metadata=np.array({"mode": "events"}, dtype=object),
    )
    source = open_events(tmp_path / "a.npz")
    kept = events[:, 0] < 2
    columns = t_us[kept], *events[kept][:, [4, 5]].T, events[kept, 0] == 1
    assert rows(source) == list(zip(*(column.tolist() for column in columns), strict=True))
    assert (source.format, source.size) == ("OpenMV NPZ", (320, 320))
    assert dict(source.losses) == {"vendor_word": 10}
    t_us = (1 << 16) * 1_000_000 + np.arange(-500, 500, dtype=np.int64) * 100
    np.savez(tmp_path / "b.npz", events=board_rows(t_us))  # the seconds wrap
    assert [row[0] for row in rows(open_events(tmp_path / "b.npz"))] == t_us.tolist()


def test_histograms_and_other_arrays_say_what_they_are(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", events=np.zeros((3, 320, 320), np.uint8))
    with pytest.raises(FormatError, match="histograms"):
        list(open_events(tmp_path / "a.npz"))
