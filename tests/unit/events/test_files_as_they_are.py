"""The same events in every form that people have: all of them are read alike."""

import gzip
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from spikingtac.errors import ConfigError, FormatError, MissingExtraError, RecordingError
from spikingtac.events import open_events
from spikingtac.events.formats.codec import Triggers
from spikingtac.types import EventPacket
from stand_ins.random_packets import assert_equal, packet_of, save_events

N, SIZE = 600, (346, 260)
rng = np.random.default_rng(11)
T = np.sort(rng.choice(900_000, N, replace=False)).astype(np.int64) + 1_000
X, Y = rng.integers(0, SIZE[0], N), rng.integers(0, SIZE[1], N)
Y[0] = 119  # In AEDAT 2.0 it begins as a line of the header does, with a #.
P = rng.random(N) < 0.6
COLUMNS = {"t": T, "x": X, "y": Y, "p": P.astype(np.int64)}
PACKET = packet_of(T, X, Y, P, SIZE).sound()


def read(path: Path, **options: Any) -> tuple[EventPacket, Any]:
    source = open_events(path, **options)
    return EventPacket.concatenate(list(source)), source


def assert_read(path: Path, shift_us: int = 0, **options: Any) -> Any:
    found, source = read(path, **options)
    assert_equal(found, packet_of(T + shift_us, X, Y, P, SIZE))
    return source


def table(order: str = "txyp", mark: str = ",", head: str = "", **changes: Any) -> str:
    """Return the events as text; ``changes`` replace a column or give its format."""
    columns = [changes.get(name, COLUMNS.get(name, 7)) for name in order]
    rows = zip(*(np.broadcast_to(column, N) for column in columns), strict=True)
    return head + "\n".join(mark.join(str(value) for value in row) for row in rows) + "\n"


SIGNS = np.where(P, 1, -1)
WORDS = np.where(P, "ON", "OFF")
SECONDS = np.array([f"{t / 1e6:.6f}" for t in T])
COMMAS = [seconds.replace(".", ",") for seconds in SECONDS]
PARTS = {"x": X, "nsecs": T % 10**6 * 1_000, "y": Y, "p": P, "secs": T // 10**6}
TEXTS: dict[str, str] = {
    "x,y,p,t without a header": table("xypt"),
    "x,y,t,p without a header, signs": table("xytp", " ", p=SIGNS),
    "first line of the size": table(mark=" ", head="346 260\n", t=SECONDS),
    "any order by a header": table("pyxt", head="Polarity,Y,X,Timestamp\n"),
    "ms in a suffix": table(head="t_ms,x,y,p\n", t=T / 1e3),
    "seconds in brackets": table(mark=";", head="time (s);col;row;on\n", t=SECONDS),
    "decimal commas": table(mark=";", head="time (s);x;y;p\n", t=COMMAS),
    "decimal commas between blanks": table(mark=" ", t=COMMAS),
    "fractions that are far apart": table(t=T + 0.25),
    "faery's header": table(head="t,x@346,y@260,on\n"),
    "v2e's comments": table(
        mark=" ",
        head="#!events.txt\n# made by v2e\n#Format: time (float s), x, y, polarity (0=off, 1=on)\n",
        t=SECONDS,
    ),
    "exponents, as numpy.savetxt writes them": table(t=[f"{t:.18e}" for t in T]),
    "quotes": "".join(f'"{line}"\n' for line in table(mark='","').splitlines()),
    "a byte order mark, and columns by number": "\ufeff0,1,2,3\n" + table(),
    "%geometry": table("xypt", head="%geometry:346,260\n"),
    "size in a comment": table(head="# size 346 260\n# by hand\n"),
    "CRLF": table(head="t,x,y,p\n").replace("\n", "\r\n"),
    "polarity as words": table(head="addr_x,addr_y,t,polarity\n", order="xytp", p=WORDS),
    "polarity as signs alone": table(mark=" ", p=np.where(P, "+", "-")),
    "a label of words": table("txypl", head="t,x,y,p,label\n", l=np.where(P, "slow press", "tap")),
    "a label without a header": table("txlyp", ";", l="b", p=np.where(P, "on", "off")),
    "an empty column": table("tnxypv", head="t,note,x,y,p,valid\n", n="", v=1),
    "cells that may be empty": table("txnypm", "\t", n=np.where(P, "", "a b"), m="", p=WORDS),
    "commas at the ends": table(mark=", ").replace("\n", ", \n"),
    "two times": table("xysnp", head="x,y,t.sec,t.nanosec,p\n", s=T // 10**6, n=PARTS["nsecs"]),
    "whole seconds since 1970, and the rest": table(
        "xysfp", head="x,y,t_s,t_frac,p\n", s=T // 10**6 + 1_700_000_000, f=T % 10**6 / 1e6
    ),
    "a unit of two words": table(head="t (micro-seconds),x,y,p\n"),
    "the mark of a spreadsheet": table(mark=";", head="sep=;\nt;x;y;p\n"),
    "UTF-16": table(head="t,x,y,p\n"),
    "Latin-1": table(head="time (µs),x,y,p\n"),
    "nanoseconds since 1970": table(t=T * 1_000 + 1_700_000_000 * 10**9),
    "seconds since 1970": table(t=[f"{1_700_000_000 + t / 1e6:.6f}" for t in T]),
}


@pytest.mark.parametrize("form", TEXTS)
def test_text(tmp_path: Path, form: str) -> None:
    encoding = form if form in ("UTF-16", "Latin-1") else "utf-8"
    (tmp_path / "a.csv").write_text(TEXTS[form], encoding=encoding, newline="")
    source = assert_read(tmp_path / "a.csv", 1_700_000_000_000_000 if "1970" in form else 0)
    assert source.size == SIZE
    assert not source.losses
    assert any("microseconds" in note for note in source.notes) == ("fractions" in form)


@pytest.mark.parametrize(("mark", "t"), [(",", T - 500_000), ("\t", (T - 500_000) / 1e6)])
def test_rows_out_of_order_are_sorted_and_counted(tmp_path: Path, mark: str, t: Any) -> None:
    lines = table(mark=mark, t=t).splitlines()
    mixed = [lines[k] for k in np.random.default_rng(1).permutation(N)]
    head = mark.join("txyp")
    (tmp_path / "a.txt").write_text("\n".join([head, *mixed]))
    assert assert_read(tmp_path / "a.txt", -500_000).losses["unsorted"] > N // 3
    lines[10], lines[11] = lines[11], lines[10]
    (tmp_path / "b.txt").write_text("\n".join([head, *lines]))
    assert dict(assert_read(tmp_path / "b.txt", -500_000).losses) == {"unsorted": 1}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("t,x,y\n1,2,3\n", "lacks p; wanted .* ON and OFF or true"),
        ("t,x,y,p,time\n1,2,3,1,5\n", "twice"),
        ("t_s,t_us,x,y,p\n0.5,500000,2,3,1\n1.5,1500000,2,3,0\n", "twice"),
        ("time [0.1 ms],x,y,p\n1,2,3,1\n", "lacks t; wanted are columns of time"),
        ("[1, 2, 3, 1]\n[4, 5, 6, 0]\n", r"as '\[1,2,3,1\]', have 4 columns, but time"),
        ("t,x,y,p\n1,2,3\n4,5,6\n", "3 columns and the header 4, but time, x, y and polarity"),
        ('t x y p\n"1" 15 2 3 1\n"2" 25 3 4 0\n', "5 columns and the header 4, but time"),
        ("t,x,y,p\n", "holds no events: nothing was recorded"),
        ("t,x,y,p\n2024-01-01,1,2,1\n", r"none can be read \(bad_record 1\)"),
        ("0,1,2,1\n1,2,3,0\n", r"several ways: x,y,t,p; t,x,y,p"),
        ("1.5,2.5,3.5,1\n2.5,4.5,6.5,0\n", "fit no order"),
        ("t,x,y,p\n1,2,3,17\n2,3,4,99\n", "the polarity holds 17, 99"),
        ("t,x,y,p\n1,2,3,0\n2,3,4,-1\n", "the polarity holds -1, 0; valid"),
    ],
)
def test_what_cannot_be_told_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordingError, match=told):
        read(tmp_path / "a.csv")


def structured(**kinds: str) -> np.ndarray:
    rows = np.zeros(N, list(kinds.items()))
    for name in kinds:
        rows[name] = COLUMNS[name[0]]
    return rows


def rows(order: str, kind: Any = np.int64, p: Any = None) -> np.ndarray:
    columns = COLUMNS | ({} if p is None else {"p": p})
    return np.column_stack([columns[name] for name in order]).astype(kind)


ARRAYS: dict[str, Any] = {
    "Metavision": structured(x="<u2", y="<u2", p="<i2", t="<i8"),
    "dv": structured(timestamp="<i8", x="<i2", y="<i2", polarity="?"),
    "big-endian": structured(t=">i8", x=">u2", y=">u2", p="u1"),
    "t,x,y,p": rows("txyp", float),
    "by columns": np.asfortranarray(rows("xypt")),
    "across": np.ascontiguousarray(rows("txyp").T),
    "wrapped": rows("txyp", np.uint32, SIGNS),
    "seconds": rows("txyp", float) / [1e6, 1, 1, 1],
    "structures in two axes": structured(t="<i8", x="<u2", y="<u2", p="?").reshape(1, -1),
}


@pytest.mark.parametrize("form", ARRAYS)
def test_arrays(tmp_path: Path, form: str) -> None:
    np.save(tmp_path / "a.npy", ARRAYS[form])
    np.savez_compressed(tmp_path / "a.npz", events=ARRAYS[form], pose=np.eye(4))
    for name in ("a.npy", "a.npz"):
        assert assert_read(tmp_path / name).size == SIZE
    if form == "t,x,y,p":
        (tmp_path / "a.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-100])
        found, source = read(tmp_path / "a.npy")
        assert (len(found), source.losses) == (N - 4, {"truncated": 1})


def group(file: Any, place: str, t: Any = T, axes: Any = -1, **names: str) -> None:
    names = {name: name for name in "xypt"} | names
    for role, column in (COLUMNS | {"t": t}).items():
        file[f"{place}/{names[role]}"] = column.reshape(axes)


def m3ed(file: Any) -> None:
    group(file, "prophesee/left")
    file["prophesee/left/calib/resolution"] = np.array([640, 480])
    file["prophesee/left/ms_map_idx"] = np.arange(900)


def dsec(file: Any) -> None:
    group(file, "events", t=(T - 700).astype(np.uint32))
    file["t_offset"], file["ms_to_idx"] = np.int64(700), np.arange(900)


def mvsec(file: Any) -> None:
    file["davis/left/events"] = rows("xytp", float, SIGNS) / [1, 1, 1e6, 1]
    file["davis/left/imu"] = np.zeros((50, 6))
    file["davis/left/image_raw_event_inds"] = np.arange(30)


def openeb(file: Any) -> None:
    file.create_dataset("CD/events", data=ARRAYS["Metavision"], compression="gzip")
    edge = np.dtype([("p", "<i2"), ("t", "<i8"), ("id", "<i2")])
    file["EXT_TRIGGER/events"] = np.array([(1, 5_000, 6), (0, 9_000, 6)], edge)
    file.attrs["geometry"] = "346x260"


def e2vid(file: Any) -> None:
    group(file, "events", t=T / 1e6, x="xs", y="ys", p="ps")
    file.move("events/t", "events/ts")
    file["events"].attrs["sensor_resolution"] = np.array([260, 346])


HDF5: dict[str, Callable[[Any], object]] = {
    "v2e": lambda file: file.create_dataset("events", data=rows("txyp", np.uint32), chunks=(97, 4)),
    "MVSEC": mvsec,
    "M3ED": m3ed,
    "DSEC": dsec,
    "OpenEB": openeb,
    "e2vid": e2vid,
    "seconds and nanoseconds": lambda file: file.update(PARTS),
    "an attribute's unit": lambda file: (
        group(file, "events", t=T * 1_000),
        file["events/t"].attrs.update(units="nanoseconds"),
    ),
    "columns at the root": lambda file: group(file, ""),
    "MATLAB's rows": lambda file: group(file, "events", axes=(1, -1)),
    "MATLAB's columns": lambda file: group(file, "events", axes=(-1, 1)),
    "across": lambda file: file.create_dataset("events", data=rows("txyp").T),
}


@pytest.mark.parametrize("form", HDF5)
def test_hdf5(tmp_path: Path, form: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        HDF5[form](file)
    source = assert_read(tmp_path / "a.h5")
    assert source.size == ((640, 480) if form == "M3ED" else SIZE)
    if form == "OpenEB":
        assert list(source.triggers) == [(5_000, 6, True), (9_000, 6, False)]


@pytest.mark.parametrize("axes", [(1, -1), (-1, 1)])
def test_columns_of_two_axes_in_npz(tmp_path: Path, axes: tuple[int, int]) -> None:
    for columns in (COLUMNS, PARTS):
        np.savez(tmp_path / "a.npz", **{name: c.reshape(axes) for name, c in columns.items()})
        assert_read(tmp_path / "a.npz")


def test_an_empty_table_says_that_nothing_was_recorded(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["events"] = np.zeros((0, 4), np.uint32)
    with pytest.raises(FormatError, match="holds no events: nothing was recorded into it"):
        open_events(tmp_path / "a.h5")
    assert not list(open_events(tmp_path / "a.h5", size=SIZE))


def test_what_is_written_has_openebs_layout(tmp_path: Path) -> None:
    save_events(tmp_path / "a.h5", *(PACKET.part(k, k + 97, 0, 0) for k in range(0, N, 97)))
    with h5py.File(tmp_path / "a.h5") as file:
        events = file["CD/events"]
        assert (events.dtype.itemsize, events.dtype.names) == (16, ("x", "y", "p", "t"))
        np.testing.assert_array_equal(events["t"], T)
        assert file["EXT_TRIGGER/events"].dtype.itemsize == 24


def test_two_cameras_in_hdf5_are_chosen_by_number(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group(file, "prophesee/left", t=T + 5)
        group(file, "prophesee/right")
    with pytest.raises(ConfigError, match=r"--sensor.*0 \(/prophesee/left\), 1 \(/prophesee/right"):
        open_events(tmp_path / "a.h5")
    assert_read(tmp_path / "a.h5", sensor=1)
    assert_read(tmp_path / "a.h5", 5, sensor=0)


def test_prophesees_compression_is_named_with_a_package_that_reads_it(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        kind = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        kind.set_chunk((N,))
        kind.set_filter(0x8ECF, h5py.h5z.FLAG_OPTIONAL, ())
        events = ARRAYS["Metavision"]
        space, of = h5py.h5s.create_simple((N,)), h5py.h5t.py_create(events.dtype, logical=True)
        made = h5py.h5d.create(file.create_group("CD").id, b"events", of, space, kind)
        made.write_direct_chunk((0,), b"compressed" * 9, filter_mask=0)
    with pytest.raises(MissingExtraError, match="pip install evlib"):
        read(tmp_path / "a.h5", size=SIZE)


def aedat2(chip: str, words: np.ndarray, times: np.ndarray) -> bytes:
    pairs = np.column_stack([words, times]).astype(">u4")
    head = f"#!AER-DAT2.0\r\n# This is a raw AE data file\r\n# AEChip: {chip}\r\n"
    return head.encode() + pairs.tobytes()


def test_aedat2_of_a_davis_leaves_frames_and_imu_out(tmp_path: Path) -> None:
    words = (259 - Y) << 22 | (345 - X) << 12 | P.astype(np.int64) << 11
    others = np.array([1 << 31 | 5 << 12, 1 << 31 | 3 << 10, 1 << 10])  # a frame, IMU, special
    data = aedat2(
        "eu.seebetter.ini.chips.davis.DAVIS346blue",
        np.insert(words, [3, 40, 90], others),
        np.insert(T, [3, 40, 90], T[[3, 40, 90]]),
    )
    (tmp_path / "a.aedat").write_bytes(data + b"\0\0\0")
    source = assert_read(tmp_path / "a.aedat")
    assert (source.size, dict(source.losses)) == (SIZE, {"other_data": 3, "truncated": 1})
    (tmp_path / "a.aedat").write_bytes(aedat2("some.Retina", words, T))
    with pytest.raises(FormatError, match="names no chip"):
        open_events(tmp_path / "a.aedat")


def test_aedat3_keeps_its_triggers_and_leaves_frames_out(tmp_path: Path) -> None:
    data = X.astype("u4") << 17 | Y.astype("u4") << 2 | P.astype("u4") << 1 | 1
    data[7] ^= 1  # not valid

    def packet(kind: int, size: int, body: bytes) -> bytes:
        count = len(body) // size
        return struct.pack("<hhiiiiii", kind, 1, size, 4, 1, count, count, count) + body

    pairs = np.column_stack([data, T]).astype("<u4")
    special = np.array([2 << 1 | 1, 100, 3 << 1 | 1, 200, 7 << 1 | 1, 300], "<u4")
    head = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n"
    parts = packet(0, 8, special.tobytes()), packet(1, 8, pairs[:300].tobytes())
    frames = packet(2, 36, bytes(72)), packet(3, 36, bytes(36))
    parts += *frames, packet(1, 8, pairs[300:].tobytes())
    (tmp_path / "a.aedat").write_bytes(b"".join([head, *parts]))
    found, source = read(tmp_path / "a.aedat")
    np.testing.assert_array_equal(found.t, np.delete(T, 7) + (1 << 31))
    np.testing.assert_array_equal(found.y, np.delete(Y, 7))
    since = 1 << 31
    edges = [(since + 100, 0, True), (since + 200, 0, False), (since + 300, 1, False)]
    assert list(source.triggers) == edges
    assert dict(source.losses) == {"other_data": 3, "trigger": 3}


def test_aedat4_of_two_cameras_and_its_triggers(tmp_path: Path) -> None:
    dv = pytest.importorskip("dv_processing", reason="the oracle comes with the extra [dv]")
    left, right = (dv.io.MonoCameraWriter.Config(name) for name in ("LEFT_1", "RIGHT_2"))
    for camera in (left, right):
        camera.addEventStream(SIZE)
        camera.addTriggerStream()
    writer = dv.io.StereoCameraWriter(str(tmp_path / "a.aedat4"), left, right)
    for side, shift in ((writer.left, 0), (writer.right, 5)):
        store = dv.EventStore()
        for t, x, y, p in zip(T.tolist(), X.tolist(), Y.tolist(), P.tolist(), strict=True):
            store.push_back(t + shift, x, y, p)
        side.writeEvents(store)
    writer.left.writeTrigger(dv.Trigger(7_000, dv.TriggerType.EXTERNAL_SIGNAL_RISING_EDGE))
    writer.left.writeTrigger(dv.Trigger(8_000, dv.TriggerType.EXTERNAL_SIGNAL_FALLING_EDGE))
    writer.left.writeTrigger(dv.Trigger(8_500, dv.TriggerType.APS_FRAME_START))
    del writer, side
    with pytest.raises(ConfigError, match=r"0 \(LEFT_1, 346x260 px\), 1 \(RIGHT_2"):
        open_events(tmp_path / "a.aedat4")
    source = assert_read(tmp_path / "a.aedat4", sensor=0)
    assert list(source.triggers) == [(7_000, 0, True), (8_000, 0, False)]
    assert_read(tmp_path / "a.aedat4", 5, sensor=1)


@pytest.mark.parametrize("name", ["a.raw", "events.csv", "a.npz", "Events_2.aedat4"])
def test_packed_recordings(tmp_path: Path, name: str) -> None:
    content = save_events(tmp_path / name, PACKET).read_bytes()
    (tmp_path / f"{name}.gz").write_bytes(gzip.compress(content))
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        beside = ["imu.txt"] if "vents" in name else []
        for other in ("__MACOSX/junk", "day/.DS_Store", "README.txt", "day/setup.png", *beside):
            archive.writestr(other, b"")
        archive.writestr(f"day/{name}", content)
    for path in (tmp_path / f"{name}.gz", tmp_path / "a.zip"):
        source = assert_read(path)
        assert any("unpacked" in note for note in source.notes)
        folder = source.path.parent
        del source
        assert not folder.exists()


def test_archives_are_bounded_and_must_hold_one_recording(tmp_path: Path) -> None:
    (tmp_path / "bomb.gz").write_bytes(gzip.compress(bytes(300 << 20), 9))
    with pytest.raises(FormatError, match="unpacks to more than"):
        open_events(tmp_path / "bomb.gz")
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        for name in ("a.raw", "b.raw"):
            archive.writestr(name, b"% evt 3.0\n")
    with pytest.raises(FormatError, match=r"holds a\.raw, b\.raw; a zip with exactly one"):
        open_events(tmp_path / "two.zip")
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(table().encode())[:3_000])
    found, source = read(tmp_path / "cut.csv.gz")
    assert 100 < len(found) < N
    assert source.losses["truncated"] == 1


@pytest.mark.parametrize("encoding", ["evt2", "evt21", "evt3"])
def test_the_content_decides_before_the_ending(tmp_path: Path, encoding: str) -> None:
    data = save_events(tmp_path / "a.raw", PACKET, encoding=encoding).read_bytes()
    for name in ("a.bin", "a.csv", "a", "a.dat"):
        (tmp_path / name).write_bytes(data)
        assert assert_read(tmp_path / name).format.startswith("EVT")
    for name in ("b.log", "b.dat", "b.npz"):
        (tmp_path / name).write_text("% t x y p\n" + table(mark=" "))
        assert_read(tmp_path / name)
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        group(file, "events", axes=(1, -1))
    with (tmp_path / "b.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    assert_read(tmp_path / "b.mat")


@pytest.mark.parametrize("encoding", ["evt2", "evt21", "evt3"])
def test_triggers_outlive_a_copy(tmp_path: Path, encoding: str) -> None:
    triggers = Triggers()
    triggers.append(
        [T[0] - 5, T[5], T[5] + 1, 500_000, T[-1] + 70], [0, 1, 1, 4, 0], [1, 1, 0, 1, 0]
    )
    for name, code in (("a.raw", encoding), ("a.npz", None), ("a.h5", None)):
        parts = PACKET.part(0, 300, 0, 0), PACKET.part(300, N, 0, 0)
        save_events(tmp_path / name, *parts, encoding=code, triggers=triggers)
        source = assert_read(tmp_path / name, strict=True)
        assert list(source.triggers) == list(triggers)
        assert source.triggers.channels()["1"]["count"] == 2
