"""Event files of every format, what random damage makes of them, and how they are read."""

import gzip
import struct
from itertools import islice
from pathlib import Path

import numpy as np

from spikingtac.errors import SpikingTacError
from spikingtac.events import open_events
from spikingtac.events.windows import windows
from stand_ins.bags import cdr, mcap_file, packet_words, ros1_bag, write_db3
from stand_ins.random_packets import random_packet, save_events

SIZE = (320, 320)
EVENTS = random_packet(5, 4_000, SIZE, steps_us=50)
RAW_KINDS = ("evt2", "evt21", "evt3")
CONTAINERS = (
    "npz", "npy", "csv", "es", "dat", "aedat", "aedat4", "h5", "mcap", "bag", "db3", "gz",
)  # fmt: skip
KINDS = (*RAW_KINDS, *CONTAINERS)

FILE_NAMES = {kind: "a.raw" for kind in RAW_KINDS} | {kind: f"a.{kind}" for kind in CONTAINERS}

WINDOW_US = 10_000
MOST_WINDOWS = 1_000_000  # Windows that are looked at: damaged times may claim days of silences.

# Numbers that lengths and times are replaced by.
ODD_NUMBERS = (0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 59, (1 << 64) - 1)


def seed_file(kind: str, folder: Path) -> Path:
    """Write a sound file of a kind, a few ten thousand bytes, and return it."""
    path = folder / FILE_NAMES[kind]
    if kind in RAW_KINDS:
        save_events(path, EVENTS, encoding=kind)
    elif kind in _OTHERS:
        path.write_bytes(_OTHERS[kind]())
    elif kind == "npy":
        np.save(path, np.column_stack([getattr(EVENTS, name) for name in "txyp"]))
    elif kind == "gz":
        raw = save_events(path.with_name("b.raw"), EVENTS)
        path.write_bytes(gzip.compress(raw.read_bytes(), mtime=0))
    elif kind in ("mcap", "bag", "db3"):
        ros1 = kind == "bag"
        messages = [cdr(k, b"evt3", packet_words(50 * k) * 4, ros1=ros1) for k in range(200)]
        chunks = [messages[first : first + 20] for first in range(0, 200, 20)]
        if kind == "db3":
            write_db3(path, messages)
        else:
            path.write_bytes(ros1_bag(chunks, "lz4") if ros1 else mcap_file(chunks, "zstd"))
    else:
        save_events(path, EVENTS)
    return path


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return data with one to three kinds of damage."""
    out = bytearray(data)
    for kind in rng.integers(0, 8, int(rng.integers(1, 4))).tolist():
        if len(out) <= 16:
            break
        # Every third place lies in the first kilobyte, where the headers are.
        limit = len(out) if rng.integers(0, 3) else min(len(out), 1_024)
        first, length = int(rng.integers(0, limit)), int(rng.integers(1, 9))
        if kind == 0:
            for place in rng.integers(0, limit, int(rng.integers(1, 17))):
                out[place] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del out[first + 1 :]
        elif kind == 2:
            del out[first : first + length]
        elif kind == 3:
            out[first:first] = rng.bytes(length)
        elif kind == 4:
            out[first:first] = out[limit // 2 : limit // 2 + 64 * length]
        elif kind == 5:
            number = struct.pack("<Q", ODD_NUMBERS[int(rng.integers(0, len(ODD_NUMBERS)))])
            out[first : first + length] = number[: min(length, len(out) - first)]
        else:
            length = min(length << (3 if kind == 6 else 10), len(out) - first)
            out[first : first + length] = (
                rng.bytes(length) if kind == 6 else bytes([int(rng.choice([0, 255]))]) * length
            )
    return bytes(out)


def outcome(path: Path) -> str:
    """Return ``read`` or ``refused`` for a file; anything else that happens is an error.

    Raises:
        AssertionError: A packet breaks what packets promise.
        Exception: Whatever else the reader raised that is no error of this package.
    """
    try:
        source = open_events(path)
        end_us = None
        for packet in source:
            assert end_us in (None, packet.t_start_us), "spans with gaps"
            end_us = packet.t_end_us
            assert len(packet.x) == len(packet.y) == len(packet.p) == len(packet.t)
            if len(packet):
                assert packet.t[0] >= packet.t_start_us, "an event before its packet"
                assert packet.t[-1] < packet.t_end_us, "an event after its packet"
                assert (np.diff(packet.t) >= 0).all(), "time goes back"
                assert packet.x.max() < source.size[0], "a column beyond the sensor"
                assert packet.y.max() < source.size[1], "a row beyond the sensor"
        for _ in islice(windows(source, WINDOW_US), MOST_WINDOWS):
            pass
    except SpikingTacError as error:
        return "refused" if str(error) else "an error without words"
    return "read"


def _dat() -> bytes:
    address = EVENTS.p.astype("u4") << 28 | EVENTS.y.astype("u4") << 14 | EVENTS.x
    body = np.column_stack([EVENTS.t, address]).astype("<u4")
    return b"% Version 2\n% Height 320\n% Width 320\n\x0c\x08" + body.tobytes()


def _es() -> bytes:
    overflows, rest = np.divmod(np.diff(EVENTS.t, prepend=0), 127)
    out = b"Event Stream\x02\x00\x00\x01" + struct.pack("<HH", *SIZE)
    columns = overflows, rest << 1 | EVENTS.p, EVENTS.x, SIZE[1] - 1 - EVENTS.y.astype(int)
    for more, head, x, row in np.column_stack(columns).tolist():
        out += b"\xff" * more + struct.pack("<BHH", head, x, row)
    return out


def _aedat3() -> bytes:
    data = EVENTS.x.astype("u4") << 17 | EVENTS.y.astype("u4") << 2 | 1
    body = np.column_stack([data, EVENTS.t]).astype("<u4")
    head = b"#!AER-DAT3.1\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n"
    for packet in np.split(body, len(body) // 100):
        head += struct.pack("<hhiiiiii", 1, 1, 8, 4, 0, *(3 * [len(packet)])) + packet.tobytes()
    return head


_OTHERS = {"dat": _dat, "es": _es, "aedat": _aedat3}
